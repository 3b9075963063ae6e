/* The firmware's entry under libFuzzer: each input is a short life of a vehicle, byte by byte what happens to it.

   Bytes on the line, good frames with any payload, good frames spoilt afterwards, time, sticks of the safety pilot, a board that refuses,
   keys, flash full of anything. What must hold whatever happens is checked after every step; sanitizers look for the rest. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "key.h"
#include "pulse.h"
#include "vehicle.h"

void power_new(uint32_t seed, int garbage);
int power_start(uint32_t n, uint32_t copied);
int power_append(uint32_t tag, uint64_t value);
int64_t power_find(uint32_t tag);

enum { LINE, GOOD, SPOILT, TIME, LONG_TIME, RADIO, REFUSE, COUNT, KEY, FLASH, KINDS };

static const uint8_t SECRET[KEY_SIZE] = "the key of the fuzzed vehicle..";
static vehicle v;
static link peer;
static int64_t now;
static uint8_t line[512];
static size_t line_from, line_to;
static uint16_t sticks[RADIO_CHANNELS], count, pulses[CHANNELS];
static bool radio, refused, own;
static uint32_t good;

int64_t board_now(void) { return now; }
uint32_t board_lost(void) { return 0; }
uint32_t board_stack(void) { return 0; }
void board_wait(void) {}
void board_remember(uint64_t number) { (void)number; }
uint64_t board_recall(void) { return 0; }
const uint8_t *board_key(void) { return NULL; }
const char *board_cause(void) { return "power on"; }
const char *board_refusal(void) { return refused ? "crystal" : NULL; }
void board_store(int which, float value) { (void)which, (void)value; }
bool board_load(int which, float *value) { return (void)which, (void)value, false; }
void board_kick(void) {}
void board_rest(void) {}
void board_record(const uint32_t record[RECORD_WORDS]) { (void)record; }
uint16_t board_encoder(int64_t at) { return (uint16_t)(count + at / 5000); }
void hardware_begin(void) {}
motion hardware_motion(void) { return (motion){0.0f, 0.0f}; }
void hardware_work(vehicle *vehicle, int64_t at) { (void)vehicle, (void)at; }
void board_pulse(int channel, uint16_t counts) { pulses[channel] = counts; }

bool board_write(const uint8_t *bytes, size_t n) {
    static uint8_t sink;
    for (size_t i = 0; i < n; ++i) sink ^= bytes[i];
    return n <= FRAME_MAX;
}

bool board_read(uint8_t *byte) {
    if (line_from == line_to) return false;
    *byte = line[line_from++];
    return true;
}

bool board_radio(uint16_t us[RADIO_CHANNELS]) {
    memcpy(us, sticks, sizeof sticks);
    return radio;
}

static void work(void) {
    do vehicle_work(&v);
    while (line_from < line_to);
}

static void assert_at(bool holds, int where) {
    if (holds) return;
    fprintf(stderr, "coverage.c:%d does not hold\n", where);
    abort();
}

#define must(holds) assert_at(holds, __LINE__)

static void check(void) {
    const failsafe_out *out = &v.failsafe_out;
    for (int i = 0; i < CHANNELS; ++i) must(pulses[i] >= PULSE_LOW && pulses[i] <= PULSE_HIGH);
    if (!out->command.valid) must(pulses[THRUST] == PULSE_NEUTRAL); /* stopped in the same millisecond */
    must(v.link.counts.accepted == good || own);
    must(v.link.in.n <= FRAME_MAX);
}

/* A frame with the key and a new stamp, of one of the messages that the vehicle hears; the payload is the input's. */
static size_t sign(uint8_t *to, uint8_t kind, const uint8_t *payload, size_t n) {
    static const uint32_t IDS[] = {MAVLINK_MSG_ID_COMMAND, MAVLINK_MSG_ID_TIMESYNC, MAVLINK_MSG_ID_COMMAND_LONG, MAVLINK_MSG_ID_PARAM_SET};
    mavlink_message_t m = {0};
    const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(IDS[kind % 4]);
    uint8_t size = entry->max_msg_len;
    uint64_t stamp = 2000 + (uint64_t)now / 100; /* its clock goes as the vehicle's */
    if (stamp > peer.signing.timestamp) peer.signing.timestamp = stamp;
    m.msgid = entry->msgid;
    memcpy(_MAV_PAYLOAD_NON_CONST(&m), payload, n < size ? n : size);
    mavlink_finalize_message_buffer(&m, 255, 190, &peer.status, entry->min_msg_len, size, entry->crc_extra);
    return mavlink_msg_to_send_buffer(to, &m);
}

static void give(const uint8_t *bytes, size_t n) {
    memcpy(line, bytes, n);
    line_from = 0;
    line_to = n;
    work();
}

/* One thing that happens; how many bytes of the input it took. */
static size_t happen(const uint8_t *d, size_t n) {
    uint8_t frame[FRAME_MAX], kind = d[0] % KINDS;
    size_t m = n > 1 ? d[1] % 64u : 0u, body = n > 2 ? n - 2 : 0, size;
    if (m > body) m = body;
    if (kind == TIME || kind == LONG_TIME || kind == REFUSE || kind == COUNT) m = 0;
    switch (kind) {
    case LINE: give(d + 2, m); break;
    case GOOD:
    case SPOILT:
        size = sign(frame, n > 1 ? d[1] >> 6 : 0, d + 2, m);
        if (kind == SPOILT) frame[d[n - 1] % size] ^= 1u << (d[0] / KINDS % 8u);
        else if (v.link.in.n == 0) ++good; /* behind a piece of garbage it is found later */
        own = own || v.link.in.n != 0;
        give(frame, size);
        break;
    case TIME:
        for (uint32_t i = 0; n > 1 && i < d[1] % 64u; ++i) now += MILLISECOND, work(), check();
        break;
    case LONG_TIME: now += (int64_t)(n > 1 ? d[1] : 0) * SECOND, work(); break;
    case RADIO:
        radio = n > 1 && d[1] & 1;
        if (m >= sizeof sticks) memcpy(sticks, d + 2, sizeof sticks);
        break;
    case REFUSE: refused = n > 1 && d[1] & 1; break;
    case COUNT: count = (uint16_t)(count + (n > 1 ? d[1] * 7u : 0u)); break;
    default: break;
    }
    check();
    return 2 + m;
}

static void read_key(const uint8_t *d, size_t n) {
    uint8_t image[KEY_IMAGE] = "trimtab1";
    vehicle_key key;
    memcpy(image + (d[0] / KINDS % 2u ? 8 : 0), d + 1, n - 1 < KEY_IMAGE - 8 ? n - 1 : KEY_IMAGE - 8);
    if (key_read(image, &key)) must(memcmp(key.secret, image + 8, KEY_BYTES) == 0);
    (void)key_read(NULL, &key);
}

static void fill_flash(const uint8_t *d, size_t n) {
    uint32_t seed = (uint32_t)n;
    for (size_t i = 0; i < n; ++i) seed = seed * 31u + d[i];
    power_new(seed, d[0] / KINDS % 2u);
    (void)power_start(n > 1 ? d[1] : 0, 4); /* the power fails in the middle, perhaps */
    must(power_start(0, 4) == 1);
    must(power_append(seed % 4u, seed) == 1);
    must(power_find(seed % 4u) == (int64_t)seed);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size == 0) return 0;
    if (data[0] % KINDS == KEY) return read_key(data, size), 0;
    if (data[0] % KINDS == FLASH) return fill_flash(data, size), 0;
    now = 0;
    line_from = line_to = count = good = 0;
    radio = refused = own = false;
    memset(sticks, 0, sizeof sticks);
    link_begin(&peer, SECRET, 2000);
    vehicle_begin(&v, SECRET, 1000);
    for (size_t at = 0; at < size;) at += happen(data + at, size - at);
    return 0;
}
