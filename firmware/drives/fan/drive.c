#include "drive.h"

#include "pulse.h"

enum { PERIOD = 100000, MOST_LATE = 10000000 }; /* of the regulator, in units of 100 ns */

static const double RADIO_FULL_RPM = 12000; /* speed that the safety pilot's stick asks for at its end */

const parameter drive_parameters[] = {
    {"reg.kp", 0.0f, 1.0f},
    {"reg.ki", 0.0f, 10.0f},
    {"reg.limit", 0.05f, 1.0f},
    {"reg.stall", 0.1f, 5.0f},
    {"reg.stall_duty", 0.02f, 1.0f},
};

/* In the order of the table. */
float drive_parameter(const drive *d, int k) {
    const speed_regulator_params *p = &d->params;
    const speed_regulator_real places[DRIVE_PARAMETERS] = {p->kp, p->ki, p->limit, p->stall, p->stall_duty};
    return (float)places[k];
}

void drive_set_parameter(drive *d, int k, float value) {
    speed_regulator_params *p = &d->params;
    speed_regulator_real *const places[DRIVE_PARAMETERS] = {&p->kp, &p->ki, &p->limit, &p->stall, &p->stall_duty};
    *places[k] = (speed_regulator_real)value;
}

void drive_defaults(drive *d) { speed_regulator_defaults(&d->params); }

void drive_begin(drive *d) { speed_regulator_init(&d->params, &d->state); }

/* Rudder as it comes, thrust as a speed. */
void drive_sticks(failsafe_in *in, const uint16_t *us) {
    in->input.manual.rudder_pulse = us ? us[RADIO_RUDDER] * 1e-6 : 1.5e-3;
    in->input.manual.speed_rpm = us ? (us[RADIO_THRUST] - 1500.0) / 500.0 * RADIO_FULL_RPM : 0;
}

static void regulate(drive *d, const failsafe_out *out, int64_t at) {
    d->in.t = at;
    d->in.input.rpm_command = out->command.value.speed_rpm;
    d->in.input.count = board_encoder(at);
    speed_regulator_step(&d->params, &d->state, &d->in, &d->out);
    d->duty = (double)d->out.duty;
}

/* The regulator measures speed by counts in a period, so a late tick makes up for the periods it missed; after a second
   it begins anew. */
void drive_work(drive *d, const failsafe_out *out, int64_t now) {
    if (now - d->next > MOST_LATE) {
        drive_begin(d);
        d->next = now / PERIOD * PERIOD;
    }
    for (; d->next <= now; d->next += PERIOD) regulate(d, out, d->next);
    if (!out->command.valid) d->duty = 0;
}

void drive_pulses(const drive *d, const failsafe_out *out, uint16_t wanted[CHANNELS]) {
    wanted[RUDDER] = pulse_width((double)out->command.value.rudder_pulse);
    wanted[THRUST] = pulse_duty(d->duty);
    wanted[LIFT] = (uint16_t)(out->lift ? PULSE_NEUTRAL + PULSE_SPAN : PULSE_NEUTRAL - PULSE_SPAN);
}

bool drive_stands(const uint16_t pulses[CHANNELS]) { return pulses[THRUST] == PULSE_NEUTRAL; }

static int64_t rpm(double speed) { return speed > -32768 && speed < 32768 ? (int64_t)speed : 0; }

/* Pulses; speed asked for and measured, in rpm; age of the command. */
void drive_record(const drive *d, const uint16_t pulses[CHANNELS], uint16_t age_ms, uint32_t words[DRIVE_WORDS]) {
    words[0] = word_pair(pulses[RUDDER], pulses[THRUST]);
    words[1] = word_pair(pulses[LIFT], rpm((double)d->in.input.rpm_command));
    words[2] = word_pair(rpm((double)d->out.speed_rpm), age_ms);
}
