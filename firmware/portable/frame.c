#include "frame.h"

#include <string.h>

#include "dialect.h"

enum { LENGTH = 1, FLAGS = 2, ID = 7 };

void frame_put(framer *f, uint8_t byte) {
    if (f->n < FRAME_MAX) f->bytes[f->n++] = byte;
}

void frame_drop(framer *f, size_t n) {
    if (n > f->n) n = f->n;
    memmove(f->bytes, f->bytes + n, f->n - n);
    f->n = (uint16_t)(f->n - n);
}

/* Skip to the next byte that may begin a frame, at least `least` bytes on. */
static void skip(framer *f, size_t least) {
    size_t n = least;
    while (n < f->n && f->bytes[n] != MAVLINK_STX) ++n;
    f->skipped += (uint32_t)n;
    frame_drop(f, n);
}

static int good_checksum(const framer *f, size_t end, uint8_t extra) {
    uint16_t found = crc_calculate(f->bytes + 1, (uint16_t)(end - 1));
    crc_accumulate(extra, &found);
    return f->bytes[end] == (found & 0xFF) && f->bytes[end + 1] == (found >> 8);
}

size_t frame_ready(framer *f) {
    for (;; skip(f, 1)) {
        if (f->n && f->bytes[0] != MAVLINK_STX) skip(f, 0);
        if (f->n <= FLAGS) return 0;
        if (f->bytes[FLAGS] & ~MAVLINK_IFLAG_SIGNED) continue;
        if (f->n < FRAME_HEADER) return 0;
        const uint8_t *id = f->bytes + ID;
        const mavlink_msg_entry_t *known = mavlink_get_msg_entry(id[0] | (uint32_t)id[1] << 8 | (uint32_t)id[2] << 16);
        if (!known || f->bytes[LENGTH] > known->max_msg_len) continue;
        size_t end = (size_t)FRAME_HEADER + f->bytes[LENGTH];
        size_t whole = end + 2 + (f->bytes[FLAGS] ? FRAME_SIGNATURE : 0);
        if (f->n < whole) return 0;
        if (good_checksum(f, end, known->crc_extra)) return whole;
        f->broken++;
    }
}
