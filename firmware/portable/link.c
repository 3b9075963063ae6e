#include "link.h"

#include <string.h>

#include "port.h"

void link_begin(link *l, const uint8_t key[KEY_SIZE], uint64_t floor) {
    memset(l, 0, sizeof *l);
    memcpy(l->signing.secret_key, key, KEY_SIZE);
    l->signing.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    l->signing.timestamp = l->stamp = l->floor = floor;
    l->status.signing = &l->signing;
    l->status.signing_streams = &l->streams;
}

void link_take(link *l, uint8_t byte) { frame_put(&l->in, byte); }

static uint64_t stamp_of(const mavlink_message_t *m) {
    uint64_t stamp = 0;
    for (int i = 6; i >= 1; --i) stamp = stamp << 8 | m->signature[i];
    return stamp;
}

/* What the library does not ask: that it is not our own, which has the same key; that its stamp is from after the start, for
   the library lets a sender it has not heard yet start up to a minute back; and that it is not over a minute behind. */
static bool is_new(link *l, const mavlink_message_t *message) {
    if (message->sysid == SYSTEM && message->compid == COMPONENT) {
        l->counts.reflected++;
        return false;
    }
    uint64_t stamp = stamp_of(message);
    bool new = stamp > l->floor && stamp + 60 * STAMPS_PER_SECOND >= l->signing.timestamp;
    l->counts.replayed += !new;
    return new;
}

/* Whether the frame of n bytes gets in; how many of its bytes are done with. One without a good signature may be none:
   a piece of one, with a checksum that is right by chance or from before the cut. The next may begin in it. */
static bool admitted(link *l, size_t n, mavlink_message_t *message, size_t *done) {
    *done = 1;
    if (!(l->in.bytes[2] & MAVLINK_IFLAG_SIGNED)) {
        l->counts.unsigned_frames++;
        return false;
    }
    uint8_t verdict = MAVLINK_FRAMING_INCOMPLETE;
    for (size_t i = 0; i < n; ++i)
        verdict = mavlink_frame_char_buffer(&l->parsing, &l->status, l->in.bytes[i], message, NULL);
    *done = n;
    if (verdict == MAVLINK_FRAMING_OK) return is_new(l, message);
    if (l->signing.last_status == MAVLINK_SIGNING_STATUS_REPLAY ||
        l->signing.last_status == MAVLINK_SIGNING_STATUS_OLD_TIMESTAMP) {
        l->counts.replayed++;
        return false;
    }
    *done = 1;
    l->counts.forged++;
    return false;
}

bool link_next(link *l, int64_t now, mavlink_message_t *message) {
    for (size_t n, done; (n = frame_ready(&l->in)) > 0;) {
        bool good = admitted(l, n, message, &done);
        frame_drop(&l->in, done);
        if (!good) continue;
        l->counts.accepted++;
        l->stamp = l->signing.timestamp;
        l->stamped_at = now;
        return true;
    }
    return false;
}

void link_tick(link *l, int64_t now) {
    if (!link_heard(l)) return;
    uint64_t stamp = l->stamp + (uint64_t)(now - l->stamped_at) / 100;
    if (stamp > l->signing.timestamp) l->signing.timestamp = stamp;
}

void link_send(link *l, const mavlink_message_t *message) {
    uint8_t bytes[FRAME_MAX];
    uint16_t n = mavlink_msg_to_send_buffer(bytes, message);
    if (board_write(bytes, n)) l->counts.sent++;
    else l->counts.dropped++;
}
