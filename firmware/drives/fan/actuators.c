/* The thrust fan's motor on its battery, and the servo: they read the timers' compare registers as servo and speed
   controller would read the pulses, and count the encoder's edges. */
#include "actuators.h"
#include "instants.h"
#include "motor.h"
#include "port.h"
#include "pulse.h"

static motor_params params;
static motor_state state;
static motor_in in;
static motor_out out;
static int64_t at;

void actuators_begin(void) {
    motor_defaults(&params);
    motor_init(&params, &state);
    at = 0;
}

void actuators_work(const uint16_t pulses[CHANNELS], int64_t now) {
    for (; at + MOTOR_PERIOD <= now; at += MOTOR_PERIOD) {
        in.t = at;
        in.input = (motor_real)pulse_duty_of(pulses[THRUST]);
        motor_step(&params, &state, &in, &out);
    }
}

uint16_t board_encoder(int64_t when) {
    actuators_work(emulated_pulses(), when);
    return (uint16_t)out.count;
}

void actuators_command(const uint16_t pulses[CHANNELS], world_in *world) {
    world->command.value.rudder_pulse = (world_real)pulse_seconds(pulses[RUDDER]);
    world->command.value.speed_rpm = (world_real)out.speed_rpm;
    world->command.valid = pulses[RUDDER] != 0;
}
