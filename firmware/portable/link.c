#include "link.h"

#include <string.h>

#include "port.h"

#ifndef MOST_LEAD_SECONDS
#define MOST_LEAD_SECONDS 40
#endif
enum { MARGIN = 60 * STAMPS_PER_SECOND, MOST_LEAD = MOST_LEAD_SECONDS * STAMPS_PER_SECOND };
/* A board has no calendar: its first stamp may lead the build, or what it has kept, by ten years. */
static const uint64_t MOST_FIRST_LEAD = 10ULL * 365 * 86400 * STAMPS_PER_SECOND;

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

/* Its sender is to be told that its clock is another; a question for the time goes before whatever else it says. */
static void note_refusal(link *l, const mavlink_message_t *message) {
    bool question = message != NULL && message->msgid == MAVLINK_MSG_ID_TIMESYNC && mavlink_msg_timesync_get_tc1(message) == 0;
    if (question) l->refusal.asked = mavlink_msg_timesync_get_ts1(message);
    else if (!l->refusal.due) l->refusal.asked = 0;
    l->refusal.due = true;
}

/* Of those without the key only who asks for the time as a part of our own system is told: it has the wrong key. */
static void note_stranger(link *l) {
    const uint8_t *b = l->in.bytes;
    if (b[5] == SYSTEM && (b[7] | (uint32_t)b[8] << 8 | (uint32_t)b[9] << 16) == MAVLINK_MSG_ID_TIMESYNC) note_refusal(l, NULL);
}

static bool is_leading(const link *l, int64_t now, uint64_t stamp) {
    if (!link_heard(l)) return stamp > l->floor + MOST_FIRST_LEAD;
    return stamp > l->anchor + (uint64_t)(now - l->anchored_at) / 100 + MOST_LEAD;
}

/* What the library does not ask: that it is not our own, which has the same key; that its stamp is from after the start, for
   the library lets a sender it has not heard yet start up to a minute back; that it is not over a minute behind; and that it
   does not lead our clock, for our own stamps, and what is stored, would move up to it. */
static bool is_new(link *l, int64_t now, const mavlink_message_t *message) {
    if (message->sysid == SYSTEM && message->compid == COMPONENT) {
        l->counts.reflected++;
        return false;
    }
    uint64_t stamp = stamp_of(message);
    bool stale = stamp <= l->floor || stamp + MARGIN < l->signing.timestamp, leading = is_leading(l, now, stamp);
    l->counts.stale += stale;
    l->counts.leading += leading;
    if (stale || leading) note_refusal(l, message);
    return !stale && !leading;
}

/* Whether the frame of n bytes gets in; how many of its bytes are done with. One without a good signature may be none:
   a piece of one, with a checksum that is right by chance or from before the cut. The next may begin in it. */
static bool admitted(link *l, int64_t now, size_t n, mavlink_message_t *message, size_t *done) {
    *done = 1;
    if (!(l->in.bytes[2] & MAVLINK_IFLAG_SIGNED)) {
        l->counts.unsigned_frames++;
        note_stranger(l);
        return false;
    }
    mavlink_signing_t signing = l->signing;
    mavlink_signing_streams_t streams = l->streams;
    uint8_t verdict = MAVLINK_FRAMING_INCOMPLETE;
    for (size_t i = 0; i < n; ++i)
        verdict = mavlink_frame_char_buffer(&l->parsing, &l->status, l->in.bytes[i], message, NULL);
    *done = n;
    if (verdict == MAVLINK_FRAMING_OK) {
        if (is_new(l, now, message)) return true;
        l->signing = signing; /* nothing is remembered of what was not believed */
        l->streams = streams;
        return false;
    }
    if (l->signing.last_status == MAVLINK_SIGNING_STATUS_REPLAY) {
        l->counts.replayed++;
        return false;
    }
    if (l->signing.last_status == MAVLINK_SIGNING_STATUS_OLD_TIMESTAMP) {
        l->counts.stale++;
        note_refusal(l, message);
        return false;
    }
    *done = 1;
    l->counts.forged++;
    note_stranger(l);
    return false;
}

bool link_next(link *l, int64_t now, mavlink_message_t *message) {
    for (size_t n, done; (n = frame_ready(&l->in)) > 0;) {
        bool good = admitted(l, now, n, message, &done);
        frame_drop(&l->in, done);
        if (!good) continue;
        if (!link_heard(l)) {
            l->anchor = stamp_of(message);
            l->anchored_at = now;
        }
        l->counts.accepted++;
        l->stamp = l->signing.timestamp;
        l->stamped_at = now;
        return true;
    }
    return false;
}

void link_tick(link *l, int64_t now) {
#ifdef STAMPS_FOLLOW_PEER /* the board's time may run faster than the other end's: the stamps follow what is received */
    (void)l, (void)now;
#else
    if (!link_heard(l)) return;
    uint64_t stamp = l->stamp + (uint64_t)(now - l->stamped_at) / 100;
    if (stamp > l->signing.timestamp) l->signing.timestamp = stamp;
#endif
}

void link_send(link *l, const mavlink_message_t *message) {
    uint8_t bytes[FRAME_MAX];
    uint16_t n = mavlink_msg_to_send_buffer(bytes, message);
    if (board_write(bytes, n)) l->counts.sent++;
    else l->counts.dropped++;
}
