#include "vehicle.h"

#include <string.h>

#include "pulse.h"
#include "tuning.h"

enum { AHEAD = 2 * STAMPS_PER_SECOND };

static const double RADIO_FULL_RPM = 12000; /* speed that the safety pilot's stick asks for at its end */

void vehicle_begin(vehicle *v, const uint8_t key[KEY_SIZE], uint64_t build_stamp) {
    memset(v, 0, sizeof *v);
    uint64_t kept = board_recall();
    link_begin(&v->link, key, kept > build_stamp ? kept : build_stamp);
    failsafe_defaults(&v->failsafe_params);
    failsafe_init(&v->failsafe_params, &v->failsafe_state);
    speed_regulator_defaults(&v->regulator_params);
    tuning_begin(v);
    speed_regulator_init(&v->regulator_params, &v->regulator_state);
    for (int i = 0; i < CHANNELS; ++i) board_pulse(i, v->pulses[i] = i == LIFT ? PULSE_NEUTRAL - PULSE_SPAN : PULSE_NEUTRAL);
}

/* The pilot's sticks: rudder as it comes, thrust as a speed. */
static void hear_pilot(vehicle *v) {
    uint16_t us[RADIO_CHANNELS];
    failsafe_in *in = &v->failsafe_in;
    bool heard = board_radio(us);
    in->input.radio = heard;
    in->input.takeover = heard && us[RADIO_MODE] > 1500;
    in->input.manual.rudder_pulse = heard ? us[RADIO_RUDDER] * 1e-6 : 1.5e-3;
    in->input.manual.speed_rpm = heard ? (us[RADIO_THRUST] - 1500.0) / 500.0 * RADIO_FULL_RPM : 0;
}

static void set_pulses(vehicle *v) {
    const failsafe_out *out = &v->failsafe_out;
    uint16_t wanted[CHANNELS];
    wanted[RUDDER] = pulse_width((double)out->command.value.rudder_pulse);
    wanted[THRUST] = pulse_duty(v->duty);
    wanted[LIFT] = (uint16_t)(out->lift ? PULSE_NEUTRAL + PULSE_SPAN : PULSE_NEUTRAL - PULSE_SPAN);
    for (int i = 0; i < CHANNELS; ++i) board_pulse(i, v->pulses[i] = wanted[i]);
}

static uint32_t pair(int64_t low, int64_t high) { return ((uint32_t)low & 0xFFFFu) | (uint32_t)high << 16; }

static int64_t rpm(double speed) { return speed > -32768 && speed < 32768 ? (int64_t)speed : 0; }

/* For the black box: ms since the start; mode, cause and whether armed; pulses; speed asked for and measured, in rpm;
   age of the command, in ms. */
static void record(const vehicle *v, int64_t now) {
    const failsafe_out *out = &v->failsafe_out;
    int64_t age = (now - v->failsafe_in.input.command.t) / MILLISECOND;
    const uint32_t words[RECORD_WORDS] = {
        (uint32_t)(now / MILLISECOND),
        (uint32_t)out->mode | (uint32_t)out->cause << 8 | (out->armed ? 1u << 16 : 0u) | (out->command.valid ? 1u << 17 : 0u),
        pair(v->pulses[RUDDER], v->pulses[THRUST]),
        pair(v->pulses[LIFT], rpm((double)v->regulator_in.input.wanted_rpm)),
        pair(rpm((double)v->regulator_out.speed_rpm), age < 0 ? 0 : age > 0xFFFF ? 0xFFFF : age),
        v->load.late,
    };
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
}

static void regulate(vehicle *v, int64_t at) {
    v->regulator_in.t = at;
    v->regulator_in.input.wanted_rpm = v->failsafe_out.command.value.speed_rpm;
    v->regulator_in.input.count = board_encoder(at);
    speed_regulator_step(&v->regulator_params, &v->regulator_state, &v->regulator_in, &v->regulator_out);
    v->duty = (double)v->regulator_out.duty;
}

/* Regulator and servos, each in its time; but where the failsafe stops the fan, it stops at once. The regulator measures
   speed by counts in a period, so a late tick makes up for the periods it missed; after a second it begins anew. */
static void drive(vehicle *v, int64_t now) {
    bool stop = !v->failsafe_out.command.valid && v->pulses[THRUST] != PULSE_NEUTRAL;
    if (now - v->next_regulator > SECOND) {
        speed_regulator_init(&v->regulator_params, &v->regulator_state);
        v->next_regulator = now / REGULATOR * REGULATOR;
    }
    for (; v->next_regulator <= now; v->next_regulator += REGULATOR) regulate(v, v->next_regulator);
    if (!v->failsafe_out.command.valid) v->duty = 0;
    if (due(now, &v->next_servo, SERVO) || stop) {
        set_pulses(v);
        station_servos(v, now);
    }
}

/* Once a second each, but not in one tick. */
static void quarter(vehicle *v, int64_t now) {
    int k = (int)(now / (SECOND / 4) % 4);
    if (k < 3) station_status(v, now, k);
    else if (link_heard(&v->link)) board_remember(v->link.signing.timestamp + AHEAD);
    if (k == 3 && !v->failsafe_out.armed && v->duty == 0) board_rest();
}

static void tick(vehicle *v, int64_t now) {
    guard(v, now);
    if (v->asked) station_answer(v);
    if (v->link.refusal.due) station_refuse(v, now);
    drive(v, now);
    hardware_work(v, now);
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
