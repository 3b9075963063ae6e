/* The portable firmware on the computer, as a library: time stands still unless it is told, bytes go in and come out. */
#include <string.h>

#include "emulated.h"
#include "key.h"
#include "pulse.h"
#include "vehicle.h"

enum { BUFFER = 1 << 20 };
static vehicle v;
static int64_t now;
static uint8_t in[BUFFER], out[BUFFER];
static size_t in_from, in_to, out_to;
static bool radio;
static uint16_t sticks[RADIO_CHANNELS];
static uint64_t kept;
static uint32_t kicks, rests, records[4096][RECORD_WORDS], recorded;
static const char *refusal;
static float parameters[32];
static bool stored[32];

int64_t board_now(void) { return now; }
uint32_t board_lost(void) { return 0; }
uint32_t board_stack(void) { return 0; }
void board_wait(void) {}
void board_remember(uint64_t number) { kept = number; }
uint64_t board_recall(void) { return kept; }
const uint8_t *board_key(void) { return NULL; }
const char *board_cause(void) { return "watchdog"; }
const char *board_refusal(void) { return refusal; }
void board_kick(void) { ++kicks; }

void board_store(int which, float value) {
    parameters[which] = value;
    stored[which] = true;
}

bool board_load(int which, float *value) {
    *value = parameters[which];
    return stored[which];
}
void board_rest(void) { ++rests; }

void board_record(const uint32_t record[RECORD_WORDS]) {
    memcpy(records[recorded++ % 4096], record, sizeof records[0]);
}

bool board_write(const uint8_t *bytes, size_t n) {
    if (n > BUFFER - out_to) return false;
    memcpy(out + out_to, bytes, n);
    out_to += n;
    return true;
}

bool board_read(uint8_t *byte) {
    if (in_from == in_to) return false;
    *byte = in[in_from++];
    return true;
}

bool board_radio(uint16_t us[RADIO_CHANNELS]) {
    memcpy(us, sticks, sizeof sticks);
    return radio;
}

void host_begin(const uint8_t *key, uint64_t stamp, uint64_t stored_number) {
    now = 0;
    in_from = in_to = out_to = 0;
    radio = false;
    kept = stored_number;
    kicks = rests = recorded = 0;
    refusal = NULL;
    if (!stored_number) memset(stored, 0, sizeof stored); /* a board as it comes from the factory */
    hardware_begin();
    vehicle_begin(&v, key, stamp);
}

/* Give bytes at time t, and let the firmware work until nothing is left to read. */
int host_work(int64_t t, const uint8_t *bytes, size_t n) {
    if (n > BUFFER) return -1;
    memcpy(in, bytes, n);
    in_from = 0;
    in_to = n;
    now = t;
    do vehicle_work(&v);
    while (in_from < in_to);
    return 0;
}

/* What it sent since the last call. */
size_t host_sent(uint8_t *bytes, size_t most) {
    size_t n = out_to < most ? out_to : most;
    memcpy(bytes, out, n);
    out_to = 0;
    return n;
}

void host_radio(int heard, uint16_t rudder, uint16_t thrust, uint16_t mode) {
    radio = heard != 0;
    sticks[RADIO_RUDDER] = rudder;
    sticks[RADIO_THRUST] = thrust;
    sticks[RADIO_MODE] = mode;
}

void host_counts(uint32_t *to) {
    const link_counts *c = &v.link.counts;
    const uint32_t all[] = {c->accepted, c->unsigned_frames, c->forged, c->replayed, c->reflected,
                            v.link.in.broken, v.link.in.skipped, c->sent, c->dropped, c->stale, c->leading,
                            v.authority.foreign, v.leading};
    memcpy(to, all, sizeof all);
}

void host_pulses(uint16_t *to) { memcpy(to, v.pulses, sizeof v.pulses); }
uint64_t host_kept(void) { return kept; }
uint16_t host_width(double seconds) { return pulse_width(seconds); }
uint16_t host_duty(double duty) { return pulse_duty(duty); }
const void *host_truth(void) { return &emulated_world()->truth; } /* numbers of world_real, in their order */
uint16_t host_line(const double *x, const double *y, int n, double at) { return pulse_counts(pulse_line(x, y, n, at)); }
uint32_t host_kicks(void) { return kicks; }
uint32_t host_rests(void) { return rests; }
uint32_t host_recorded(void) { return recorded; }
const uint32_t *host_record(uint32_t i) { return records[i]; }
void host_refuse(int refused) { refusal = refused ? "no crystal" : NULL; }
int host_key(const uint8_t *image, vehicle_key *to) { return key_read(image, to); }
