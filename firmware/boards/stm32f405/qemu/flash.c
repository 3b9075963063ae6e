/* In the place of flash.c in the emulator, whose flash can't be written: RAM, forgotten with the power. */
#include "flash.h"

enum { WORDS = 4096, BOX_WORDS = 2048 };
static uint32_t kept[2 * WORDS], box[2 * BOX_WORDS]; /* inverted: erased at the start */

static uint32_t *word(uint32_t address) {
    uint32_t in_sector = (address & 0x3FFFu) / 4u, sector = address >> 14 & 1u;
    (void)in_sector, (void)sector;
    return address >= 0x080C0000u ? box + ((address >> 17 & 1u) * BOX_WORDS + (address & 0x1FFFu) / 4u)
                                  : kept + (sector * WORDS + in_sector);
}

uint32_t flash_word(uint32_t address) { return ~*word(address); }

bool flash_program(uint32_t address, uint32_t value) {
    *word(address) |= ~value;
    return flash_word(address) == value;
}

bool flash_erase(uint32_t address) {
    uint32_t *at = word(address), n = address >= 0x080C0000u ? BOX_WORDS : WORDS;
    while (n-- > 0u) *at++ = 0;
    return true;
}
