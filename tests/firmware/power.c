/* Flash whose power fails in the middle of any write or erasure, with a journal on it.

   A write that is cut leaves some of its bits cleared; an erasure that is cut leaves each word old, erased, or anything
   in between; or all of it reads erased but what was written to its first word, and would not hold what is written
   next. Programming clears bits and never sets them; flash that is written over keeps what both have cleared. */
#include <setjmp.h>
#include <stdlib.h>
#include <string.h>

#include "flash.h"
#include "journal.h"

enum { BASE = 0x08008000, SECTOR = 1024, WORDS = SECTOR / 4 };
static uint32_t memory[2 * WORDS];
static uint32_t operations, erasures, abuses;
static bool weak[2]; /* reads erased, and is not */
static uint32_t cut_at; /* at this operation; 0: never */
static uint64_t state = 1;
static jmp_buf dead;
static journal j;

static uint32_t draw(void) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(state >> 32);
}

uint32_t flash_word(uint32_t address) { return memory[(address - BASE) / 4]; }

bool flash_program(uint32_t address, uint32_t value) {
    uint32_t *at = memory + (address - BASE) / 4;
    int k = (address - BASE) / SECTOR;
    if (weak[k] && value != 0) ++abuses;
    if (++operations == cut_at) {
        *at &= value | draw();
        longjmp(dead, 1);
    }
    *at &= value;
    return *at == value;
}

bool flash_erase(uint32_t address) {
    uint32_t *at = memory + (address - BASE) / 4;
    ++erasures;
    if (++operations == cut_at) {
        weak[(address - BASE) / SECTOR] = draw() % 3 == 0;
        for (int i = 0; i < WORDS; ++i) {
            if (weak[(address - BASE) / SECTOR]) {
                if (i > 0) at[i] = 0xFFFFFFFFu;
                continue;
            }
            uint32_t how = draw() % 3;
            at[i] = how == 0 ? at[i] : how == 1 ? 0xFFFFFFFFu : at[i] | draw();
        }
        longjmp(dead, 1);
    }
    memset(at, 0xFF, SECTOR);
    weak[(address - BASE) / SECTOR] = false;
    return true;
}

static void open_journal(uint32_t copied) {
    j = (journal){.sector = {BASE, BASE + SECTOR}, .size = SECTOR, .words = 2, .copied = copied};
    journal_open(&j);
}

/* Flash as it comes from the factory, or full of anything. */
void power_new(uint32_t seed, int garbage) {
    state = seed;
    for (int i = 0; i < 2 * WORDS; ++i) memory[i] = garbage ? draw() : 0xFFFFFFFFu;
    operations = erasures = abuses = cut_at = 0;
    weak[0] = weak[1] = false;
}

/* The board starts, with the power cut at the n-th operation from here; whether it came through. */
int power_start(uint32_t n, uint32_t copied) {
    operations = 0;
    cut_at = n;
    if (setjmp(dead)) return -1;
    open_journal(copied);
    journal_tidy(&j);
    return 1;
}

int power_append(uint32_t tag, uint64_t value) {
    const uint32_t payload[2] = {(uint32_t)value, (uint32_t)(value >> 32)};
    if (setjmp(dead)) return -1;
    return journal_append(&j, tag, payload);
}

int power_tidy(void) {
    if (setjmp(dead)) return -1;
    journal_tidy(&j);
    return 1;
}

/* The newest value of a tag as the next start finds it; -1 for none. */
int64_t power_find(uint32_t tag) {
    uint32_t payload[2];
    return journal_find(&j, tag, payload) ? (int64_t)((uint64_t)payload[1] << 32 | payload[0]) : -1;
}

uint32_t power_operations(void) { return operations; }
uint32_t power_erasures(void) { return erasures; }
uint32_t power_abuses(void) { return abuses; }
uint32_t power_failures(void) { return j.failures; }
uint32_t power_capacity(void) { return journal_capacity(&j); }
