/* Feeds the firmware a stream of garbage, damaged, unsigned, forged, replayed and good frames, cut into random pieces, and
   checks that it took every good frame and nothing else. Built with sanitizers; ./fuzz SEED BYTES. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "link.h"

int host_work(int64_t t, const uint8_t *bytes, size_t n);
void host_begin(const uint8_t *key, uint64_t stamp, uint64_t stored);
void host_counts(uint32_t *to);
size_t host_sent(uint8_t *bytes, size_t most);

enum { GOOD, UNSIGNED, FORGED, REPLAYED, FLIPPED, CUT, GARBAGE, HEADERS, KINDS };

static const uint8_t KEY[KEY_SIZE] = "the key of the fuzzed vehicle..", OTHER[KEY_SIZE] = "another key, of somebody else..";
static uint64_t state;
static uint8_t stream[4096], last[FRAME_MAX], all[65536];
static size_t used, last_size;
static uint32_t sent[KINDS];
static int64_t now;

static uint32_t draw(uint32_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)((state >> 33) % below);
}

/* A good frame of some message, its payload drawn. */
static size_t frame(link *l, uint8_t *to) {
    mavlink_message_t m;
    mavlink_command_t c = {now - draw(1000), 1.0e-3 + 1e-6 * draw(1000), (double)draw(24000) - 12000, (uint8_t)draw(2), draw(3)};
    mavlink_timesync_t t = {0, now};
    mavlink_command_long_t a = {0};
    a.command = (uint16_t)(399 + draw(3));
    a.param1 = (float)draw(3);
    switch (draw(3)) {
    case 0: mavlink_msg_command_encode_status(255, 190, &l->status, &m, &c); break;
    case 1: mavlink_msg_timesync_encode_status(255, 190, &l->status, &m, &t); break;
    default: mavlink_msg_command_long_encode_status(255, 190, &l->status, &m, &a); break;
    }
    return mavlink_msg_to_send_buffer(to, &m);
}

static void add(const uint8_t *bytes, size_t n) {
    memcpy(stream + used, bytes, n);
    used += n;
}

static void add_some(link *own, link *plain, link *forger) {
    uint8_t made[FRAME_MAX];
    size_t n = 0;
    uint32_t kind = draw(KINDS);
    if (kind == REPLAYED && !last_size) kind = GOOD;
    switch (kind) {
    case UNSIGNED: n = frame(plain, made); break;
    case FORGED: n = frame(forger, made); break;
    case REPLAYED: memcpy(made, last, n = last_size); break;
    case GARBAGE:
        for (n = 0; n < 1 + draw(200) && n < sizeof made; ++n) made[n] = (uint8_t)draw(256);
        break;
    case HEADERS: /* what begins like a frame again and again */
        for (n = 0; n < 3 + draw(60); ++n) made[n] = (uint8_t)(draw(2) ? MAVLINK_STX : draw(3));
        break;
    default: n = frame(own, made); break;
    }
    if (kind == FLIPPED) made[draw((uint32_t)n)] ^= (uint8_t)(1u << draw(8));
    if (kind == CUT) n = 1 + draw((uint32_t)n - 3); /* one byte short may by chance be made good by what follows */
    if (kind == GOOD) memcpy(last, made, last_size = n);
    sent[kind]++;
    add(made, n);
}

/* Give the stream in pieces; a piece in ten goes with a step of time. */
static void give(void) {
    for (size_t at = 0; at < used;) {
        size_t n = 1 + draw(100);
        if (n > used - at) n = used - at;
        if (!draw(10)) now += draw(30000);
        (void)host_work(now, stream + at, n);
        at += n;
    }
    used = 0;
    (void)host_sent(all, sizeof all);
}

static int expect(const char *what, uint32_t found, uint32_t least, uint32_t most) {
    printf("%s %lu", what, (unsigned long)found);
    if (found >= least && found <= most) return puts(""), 0;
    return printf(": wanted %lu to %lu\n", (unsigned long)least, (unsigned long)most), 1;
}

int main(int count, char **arguments) {
    static link own, plain, forger;
    uint32_t found[16];
    state = count > 1 ? strtoull(arguments[1], NULL, 10) : 1;
    size_t wanted = count > 2 ? strtoull(arguments[2], NULL, 10) : 1000000, given = 0;
    link_begin(&own, KEY, 2000);
    link_begin(&plain, KEY, 0);
    plain.status.signing = NULL;
    link_begin(&forger, OTHER, 2000);
    host_begin(KEY, 1000, 0);
    while (given < wanted) {
        while (used < sizeof stream - 2 * FRAME_MAX) add_some(&own, &plain, &forger);
        given += used;
        give();
    }
    memset(stream, 0, used = 600);
    give();
    host_counts(found);
    int bad = expect("accepted", found[0], sent[GOOD], sent[GOOD]);
    bad += expect("unsigned", found[1], sent[UNSIGNED], sent[UNSIGNED] + sent[FLIPPED] / 1000 + 1); /* checksums right by chance */
    bad += expect("forged", found[2], sent[FORGED], sent[FORGED] + sent[FLIPPED]); /* a flip in the signature alone */
    bad += expect("replayed", found[3], sent[REPLAYED], sent[REPLAYED] + sent[FLIPPED]);
    bad += expect("broken", found[5], 1, UINT32_MAX);
    bad += expect("skipped", found[6], 1, UINT32_MAX);
    return bad != 0;
}
