#include "vehicle.h"

#include <string.h>

#include "tuning.h"

enum { AHEAD = 2 * STAMPS_PER_SECOND };

void vehicle_begin(vehicle *v, const uint8_t key[KEY_SIZE], uint64_t build_stamp) {
    memset(v, 0, sizeof *v);
    v->authority.system = SYSTEM;
    uint64_t kept = board_recall();
    link_begin(&v->link, key, kept > build_stamp ? kept : build_stamp);
    failsafe_defaults(&v->failsafe_params);
    failsafe_init(&v->failsafe_params, &v->failsafe_state);
    drive_defaults(&v->drive);
    tuning_begin(v);
    drive_begin(&v->drive);
    for (int i = 0; i < CHANNELS; ++i) board_pulse(i, v->pulses[i] = SAFE_PULSES[i]);
}

static void hear_pilot(vehicle *v) {
    uint16_t us[RADIO_CHANNELS];
    failsafe_in *in = &v->failsafe_in;
    bool heard = board_radio(us);
    in->input.radio = heard;
    in->input.takeover = heard && us[RADIO_MODE] > 1500;
    drive_sticks(in, heard ? us : NULL);
}

static void set_pulses(vehicle *v) {
    uint16_t wanted[CHANNELS];
    drive_pulses(&v->drive, &v->failsafe_out, wanted);
    for (int i = 0; i < CHANNELS; ++i) board_pulse(i, v->pulses[i] = wanted[i]);
}

/* For the black box: ms since the start; mode, cause and whether armed; what the drive says, and the command's age in ms. */
static void record(const vehicle *v, int64_t now) {
    const failsafe_out *out = &v->failsafe_out;
    int64_t age = (now - v->failsafe_in.input.command.t) / MILLISECOND;
    uint32_t words[RECORD_WORDS] = {
        (uint32_t)(now / MILLISECOND),
        (uint32_t)out->mode | (uint32_t)out->cause << 8 | (out->armed ? 1u << 16 : 0u) | (out->command.valid ? 1u << 17 : 0u),
    };
    drive_record(&v->drive, v->pulses, (uint16_t)(age < 0 ? 0 : age > 0xFFFF ? 0xFFFF : age), words + 2);
    words[2 + DRIVE_WORDS] = v->load.late;
    board_record(words);
}

static bool due(int64_t now, int64_t *next, int64_t period) {
    if (now < *next) return false;
    *next = (now / period + 1) * period;
    return true;
}

static void guard(vehicle *v, int64_t now) {
    failsafe_in *in = &v->failsafe_in;
    int32_t mode = v->failsafe_out.mode;
    hear_pilot(v);
    in->t = now;
    in->input.command.age = (failsafe_real)((double)(now - in->input.command.t) * 1e-7);
    failsafe_step(&v->failsafe_params, &v->failsafe_state, in, &v->failsafe_out);
    in->input.command.fresh = in->input.arm = in->input.disarm = false;
    if (v->begun && v->failsafe_out.mode != mode) {
        station_changed(v);
        record(v, now);
    }
    v->begun = true;
    if (!v->failsafe_out.armed) authority_end(&v->authority);
    v->released |= v->failsafe_out.armed;
    rearm_follow(&v->rearm, v->failsafe_out.mode == FAILSAFE, v->failsafe_out.mode == COMPUTER);
}

/* The drive and the pulses, each frame; but where the failsafe stops what moves, it stops at once. */
static void send_pulses(vehicle *v, int64_t now) {
    drive_work(&v->drive, &v->failsafe_out, now);
    bool stop = !v->failsafe_out.command.valid && !drive_stands(v->pulses);
    if (due(now, &v->next_frame, FRAME) || stop) {
        set_pulses(v);
        if (due(now, &v->next_servo, SERVO) || stop) station_servos(v, now);
    }
}

/* Once a second each, but not in one tick. */
static void quarter(vehicle *v, int64_t now) {
    int k = (int)(now / (SECOND / 4) % 4);
    if (k < 3) station_status(v, now, k);
    else if (link_heard(&v->link)) board_remember(v->link.signing.timestamp + AHEAD);
    if (k == 3 && !v->failsafe_out.armed && drive_stands(v->pulses)) board_rest();
}

static void tick(vehicle *v, int64_t now) {
    guard(v, now);
    if (v->asked) station_answer(v);
    if (v->link.refusal.due) station_refuse(v, now);
    send_pulses(v, now);
    hardware_work(v, now);
    if (due(now, &v->next_moment, MOMENT_PERIOD)) rearm_note(&v->rearm, hardware_motion());
    link_tick(&v->link, now);
    tuning_work(v);
    if (due(now, &v->next_quarter, SECOND / 4)) quarter(v, now);
    if ((v->failsafe_out.armed || v->failsafe_out.lift) && due(now, &v->next_record, RECORD)) record(v, now);
    board_kick();
}

static bool listen(vehicle *v, int64_t now) {
    uint8_t byte;
    bool any = false;
    for (int most = 2048; most > 0 && board_read(&byte); --most) { /* a flood must not keep the tick waiting */
        mavlink_message_t message;
        any = true;
        link_take(&v->link, byte);
        while (link_next(&v->link, now, &message)) station_hear(v, now, &message);
    }
    return any;
}

void vehicle_work(vehicle *v) {
    int64_t now = board_now(), scheduled = v->next_tick;
    bool worked = listen(v, now);
    if (due(now, &v->next_tick, TICK)) {
        if (now - scheduled >= TICK && scheduled) v->load.late += (uint32_t)((now - scheduled) / TICK);
        tick(v, now);
        uint32_t took = (uint32_t)(board_now() - now);
        if (took > v->load.longest) v->load.longest = took;
        worked = true;
    }
    if (worked) v->load.busy += (uint32_t)(board_now() - now);
}
