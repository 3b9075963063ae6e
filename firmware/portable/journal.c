#include "journal.h"

#include "flash.h"

enum { MARK, NUMBER, COMMIT, HEADER = 4 };           /* words of a sector's head */
static const uint32_t ERASED = 0x45524153u, BLANK = 0xFFFFFFFFu;

/* CRC-32 of IEEE 802.3, bit by bit. */
static uint32_t checksum(uint32_t crc, uint32_t word) {
    for (int k = 0; k < 32; ++k) {
        uint32_t odd = (crc ^ word) & 1u;
        crc = crc >> 1 ^ (odd != 0u ? 0xEDB88320u : 0u);
        word >>= 1;
    }
    return crc;
}

static uint32_t record_size(const journal *j) { return (j->words + 2u) * 4u; }
static uint32_t first_record(const journal *j, int k) { return j->sector[k] + HEADER * 4u; }
uint32_t journal_capacity(const journal *j) { return (j->size - HEADER * 4u) / record_size(j); }
static uint32_t end_of(const journal *j, int k) { return first_record(j, k) + journal_capacity(j) * record_size(j); }

static bool committed(const journal *j, int k) {
    const uint32_t at = j->sector[k];
    return flash_word(at + MARK * 4u) == ERASED && flash_word(at + COMMIT * 4u) == checksum(ERASED, flash_word(at + NUMBER * 4u));
}

static bool blank(uint32_t from, uint32_t to) {
    for (; from < to; from += 4u)
        if (flash_word(from) != BLANK) return false;
    return true;
}

static bool is_spare(const journal *j, int k) {
    return flash_word(j->sector[k]) == ERASED && blank(j->sector[k] + 4u, j->sector[k] + j->size);
}

void journal_open(journal *j) {
    j->active = -1;
    j->number = 0;
    j->failures = 0;
    for (int k = 0; k < 2; ++k) {
        uint32_t number = flash_word(j->sector[k] + NUMBER * 4u);
        if (committed(j, k) && (j->active < 0 || number > j->number)) {
            j->active = k;
            j->number = number;
        }
    }
    if (j->active < 0) {
        j->spare = is_spare(j, 0);
        return;
    }
    j->next = end_of(j, j->active); /* behind the last slot that was touched: a torn record is passed over */
    while (j->next > first_record(j, j->active) && blank(j->next - record_size(j), j->next)) j->next -= record_size(j);
    j->spare = is_spare(j, 1 - j->active);
}

static uint32_t seal(const journal *j, uint32_t number, uint32_t tag, const uint32_t *payload) {
    uint32_t crc = checksum(checksum(BLANK, number), tag);
    for (uint32_t i = 0; i < j->words; ++i) crc = checksum(crc, payload[i]);
    return crc;
}

static bool write_record(const journal *j, uint32_t at, uint32_t number, uint32_t tag, const uint32_t *payload) {
    bool good = flash_program(at, tag);
    for (uint32_t i = 0; i < j->words; ++i) good = flash_program(at + 4u + i * 4u, payload[i]) && good;
    return flash_program(at + 4u + j->words * 4u, seal(j, number, tag, payload)) && good;
}

static bool read_record(const journal *j, uint32_t at, uint32_t *payload) {
    for (uint32_t i = 0; i < j->words; ++i) payload[i] = flash_word(at + 4u + i * 4u);
    return flash_word(at + 4u + j->words * 4u) == seal(j, j->number, flash_word(at), payload);
}

bool journal_find(const journal *j, uint32_t tag, uint32_t *payload) {
    if (j->active < 0) return false;
    for (uint32_t at = j->next; at > first_record(j, j->active);) {
        at -= record_size(j);
        if (flash_word(at) == tag && read_record(j, at, payload)) return true;
    }
    return false;
}

/* Go on in the other sector. Until its last word is written, the one in use stays the one in use. */
static bool move(journal *j) {
    int to = j->active < 0 ? 0 : 1 - j->active;
    uint32_t at = first_record(j, to), payload[JOURNAL_WORDS], number = j->number + 1u;
    if (!j->spare) return false;
    j->spare = false;
    for (uint32_t tag = 0; tag < j->copied; ++tag) {
        if (!journal_find(j, tag, payload)) continue;
        if (!write_record(j, at, number, tag, payload)) return false;
        at += record_size(j);
    }
    if (!flash_program(j->sector[to] + NUMBER * 4u, number)) return false;
    if (!flash_program(j->sector[to] + COMMIT * 4u, checksum(ERASED, number))) return false;
    j->active = to;
    j->number = number;
    j->next = at;
    return true;
}

bool journal_append(journal *j, uint32_t tag, const uint32_t *payload) {
    for (int tries = 0; tries < 2; ++tries) {
        if ((j->active < 0 || j->next >= end_of(j, j->active)) && !move(j)) break;
        uint32_t at = j->next;
        j->next += record_size(j);
        if (write_record(j, at, j->number, tag, payload)) return true; /* else a slot that was not blank: the next one */
    }
    j->failures++;
    return false;
}

static void erase(journal *j, int k) {
    (void)flash_program(j->sector[k], 0); /* half erased, it must never look finished */
    j->spare = flash_erase(j->sector[k]) && blank(j->sector[k], j->sector[k] + j->size) && flash_program(j->sector[k], ERASED);
}

void journal_tidy(journal *j) {
    int other = j->active < 0 ? 0 : 1 - j->active;
    bool half = j->active >= 0 && j->next > first_record(j, j->active) + j->size / 2u;
    if (!j->spare && (j->active < 0 || j->copied > 0u || half)) erase(j, other);
    if ((j->active < 0 || (half && j->copied > 0u)) && move(j)) erase(j, 1 - j->active);
}
