/* Program and erase by words at 2.7 V and more: RM0090 3.6. Data sheet DS8626 table 40: a word 16 us, 16 kB 0.5 s, 128 kB 2 s. */
#include "flash.h"

#include "board.h"
#include "registers.h"

enum { PG = BIT(0), SER = BIT(1), BY_WORDS = 2 << 8, STRT = BIT(16), BSY = BIT(16), ERRORS = 0xF2 };
enum { PROGRAM_LOOKS = 100000, ERASE_LOOKS = 200000000 };

#ifdef REGISTER_MODEL
uint32_t flash_word(uint32_t address) { return register_get(address); }
#else
uint32_t flash_word(uint32_t address) { return *(volatile const uint32_t *)address; }
#endif

static void unlock(void) {
    register_set(FLASH_KEYR, 0x45670123u);
    register_set(FLASH_KEYR, 0xCDEF89ABu);
    register_set(FLASH_SR, ERRORS); /* those of before */
}

static void lock(void) { register_set(FLASH_CR, BIT(31)); }

/* The caches may hold what was there before an erasure; they are emptied while off (3.5.2). */
static void empty_caches(void) {
    register_set(FLASH_ACR, 5u | BIT(8));
    register_set(FLASH_ACR, 5u | BIT(8) | BIT(11) | BIT(12));
    register_set(FLASH_ACR, 5u | BIT(8) | BIT(9) | BIT(10));
}

bool flash_program(uint32_t address, uint32_t value) {
    unlock();
    register_set(FLASH_CR, PG | BY_WORDS);
    register_set(address, value);
    bool done = register_await(FLASH_SR, BSY, 0u, PROGRAM_LOOKS) && !(register_get(FLASH_SR) & ERRORS);
    lock();
    return done && flash_word(address) == value;
}

/* Sectors 0 to 3 have 16 kB, 4 has 64, the others 128 (table 5). */
static uint32_t sector_of(uint32_t address) {
    uint32_t offset = address - 0x08000000u;
    return offset < 0x10000u ? offset >> 14 : offset < 0x20000u ? 4u : 4u + (offset >> 17);
}

bool flash_erase(uint32_t address) {
    watchdog_period(WATCHDOG_LONG, true);
    unlock();
    register_set(FLASH_CR, SER | BY_WORDS | sector_of(address) << 3);
    register_change(FLASH_CR, 0, STRT);
    bool done = register_await(FLASH_SR, BSY, 0u, ERASE_LOOKS) && !(register_get(FLASH_SR) & ERRORS);
    lock();
    empty_caches();
    watchdog_period(WATCHDOG_SHORT, false);
    return done;
}
