/* What outlasts power: time stamp and parameters in sectors 2 and 3, the black box in 10 and 11, the key in 1.

   Sectors are erased at the start and while the vehicle is disarmed. Armed, the stamp has room for 1022 s at the least
   after an erasure, and the black box for half of its 8190 records. */
#include <string.h>

#include "board.h"
#include "flash.h"
#include "journal.h"
#include "port.h"

enum { STAMP, PARAMETER, TAGS = 32 }; /* a parameter each, from PARAMETER on */

static journal small = {.sector = {0x08008000u, 0x0800C000u}, .size = 0x4000u, .words = 2, .copied = TAGS};
static journal box = {.sector = {0x080C0000u, 0x080E0000u}, .size = BOX_SIZE, .words = 6, .copied = 0};

void storage_begin(void) {
    journal_open(&small);
    journal_open(&box);
    board_rest();
}

void board_rest(void) {
    journal_tidy(&small);
    journal_tidy(&box);
}

void board_remember(uint64_t number) {
    const uint32_t words[2] = {(uint32_t)number, (uint32_t)(number >> 32)};
    (void)journal_append(&small, STAMP, words);
}

uint64_t board_recall(void) {
    uint32_t words[2];
    return journal_find(&small, STAMP, words) ? (uint64_t)words[1] << 32 | words[0] : 0u;
}

void board_store(int which, float value) {
    uint32_t words[2] = {0, 0};
    memcpy(words, &value, sizeof value);
    (void)journal_append(&small, PARAMETER + (uint32_t)which, words);
}

bool board_load(int which, float *value) {
    uint32_t words[2];
    bool found = journal_find(&small, PARAMETER + (uint32_t)which, words);
    if (found) memcpy(value, words, sizeof *value);
    return found;
}

void board_record(const uint32_t record[RECORD_WORDS]) { (void)journal_append(&box, 0, record); }

uint32_t storage_failures(void) { return small.failures + box.failures; }

const uint8_t *board_key(void) { return (const uint8_t *)0x08004000u; }
