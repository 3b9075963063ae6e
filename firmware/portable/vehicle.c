#include "vehicle.h"

#include <string.h>

#include "pulse.h"

enum { AHEAD = 2 * STAMPS_PER_SECOND };

static const double RADIO_FULL_RPM = 12000; /* speed that the safety pilot's stick asks for at its end */

void vehicle_begin(vehicle *v, const uint8_t key[KEY_SIZE], uint64_t build_stamp) {
    memset(v, 0, sizeof *v);
    uint64_t kept = board_recall();
    link_begin(&v->link, key, kept > build_stamp ? kept : build_stamp);
    failsafe_defaults(&v->failsafe_params);
    failsafe_init(&v->failsafe_params, &v->failsafe_state);
    speed_regulator_defaults(&v->regulator_params);
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
    if (v->begun && v->failsafe_out.mode != mode) station_changed(v);
    v->begun = true;
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
    bool stop = !v->failsafe_out.command.valid && v->duty != 0;
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
}

static void tick(vehicle *v, int64_t now) {
    guard(v, now);
    if (v->asked) station_answer(v);
    drive(v, now);
    hardware_work(v, now);
    link_tick(&v->link, now);
    if (due(now, &v->next_quarter, SECOND / 4)) quarter(v, now);
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
