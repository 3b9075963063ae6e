/* The slave's program on the computer, as a library: time stands still unless it is told, units and bus are the test's. */
#include <string.h>

#include "slave.h"
#include "slave_port.h"

enum { BUFFER = 1 << 16, SENT = 4096 };

static slave s;
static int64_t now;
static uint8_t said[PING_UNITS][BUFFER], asked[PING_UNITS][BUFFER], word[PIECE_BYTES];
static size_t said_from[PING_UNITS], said_to[PING_UNITS], asked_n[PING_UNITS], word_n;
static piece sent[SENT];
static size_t sent_n;
static bool bus_answers;
static uint16_t pulse;
static uint32_t kicks;

int64_t slave_now(void) { return now; }
void slave_kick(void) { ++kicks; }
void slave_wait(void) {}
void slave_lift(uint16_t counts) { pulse = counts; }

bool slave_unit_read(int unit, uint8_t *byte) {
    if (said_from[unit] == said_to[unit]) return false;
    *byte = said[unit][said_from[unit]++];
    return true;
}

bool slave_unit_write(int unit, const uint8_t *bytes, size_t n) {
    if (n > BUFFER - asked_n[unit]) return false;
    memcpy(asked[unit] + asked_n[unit], bytes, n);
    asked_n[unit] += n;
    return true;
}

bool slave_bus_write(const uint8_t *bytes, size_t n) {
    if (!bus_answers || sent_n == SENT) return false;
    sent[sent_n].n = n;
    sent[sent_n].at = now + (int64_t)(n + 1) * BUS_BYTE;
    memcpy(sent[sent_n++].bytes, bytes, n);
    return true;
}

bool slave_bus_read(uint8_t *bytes, size_t n) {
    memset(bytes, 0xFF, n);
    if (bus_answers) memcpy(bytes, word, n < word_n ? n : word_n);
    return bus_answers;
}

void host_begin(void) {
    now = 0;
    memset(said_from, 0, sizeof said_from);
    memset(said_to, 0, sizeof said_to);
    memset(asked_n, 0, sizeof asked_n);
    word_n = sent_n = kicks = 0;
    bus_answers = true;
    slave_begin(&s);
}

void host_work(int64_t t) {
    now = t;
    slave_work(&s);
}

int host_say(int unit, const uint8_t *bytes, size_t n) {
    if (n > BUFFER) return -1;
    memcpy(said[unit], bytes, n);
    said_from[unit] = 0;
    said_to[unit] = n;
    return 0;
}

void host_word(const uint8_t *bytes, size_t n) { memcpy(word, bytes, word_n = n < sizeof word ? n : sizeof word); }
void host_bus(int answers) { bus_answers = answers != 0; }
size_t host_asked(int unit) { return asked_n[unit]; }
size_t host_sent(void) { return sent_n; }
const piece *host_piece(size_t k) { return &sent[k]; }
uint16_t host_pulse(void) { return pulse; }
uint32_t host_kicks(void) { return kicks; }
uint32_t host_unacknowledged(void) { return s.unacknowledged; }
