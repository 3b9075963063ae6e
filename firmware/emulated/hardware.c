/* In the place of vehicle, sensors and actuators: the exported world, and the thrust fan's motor on its battery, in real time.

   They read the servo timers' compare registers as servo and speed controller would read the pulses, and count the
   encoder's edges. With real hardware this file goes, and drivers come in its place. */
#include "instants.h"
#include "motor.h"
#include "pulse.h"
#include "samples.h"
#include "vehicle.h"
#include "world.h"

#include "emulated.h"

static world_params world_p;
static world_state world_s;
static world_in world_i;
static world_out world_o;
static motor_params motor_p;
static motor_state motor_s;
static motor_in motor_i;
static motor_out motor_o;
static uint16_t compare[CHANNELS];
static int64_t world_at, motor_at, from, to;
static int64_t part, parts;

void board_pulse(int channel, uint16_t counts) {
    if (channel >= 0 && channel < CHANNELS) compare[channel] = counts;
}

const world_out *emulated_world(void) { return &world_o; }

void hardware_begin(void) {
    world_defaults(&world_p);
    world_init(&world_p, &world_s);
    motor_defaults(&motor_p);
    motor_init(&motor_p, &motor_s);
    world_at = motor_at = from = to = part = parts = 0;
    world_i.first = true;
}

/* The next instant at which something is due in the world; long gaps are split evenly. */
static int64_t next_instant(void) {
    if (world_i.first) return 0;
    if (part == parts) {
        from = world_at;
        to = INT64_MAX;
        for (unsigned i = 0; i < sizeof PERIODS / sizeof PERIODS[0]; ++i) {
            int64_t t = (from / PERIODS[i] + 1) * PERIODS[i];
            if (t < to) to = t;
        }
        part = 0;
        parts = (to - from + MAX_STEP - 1) / MAX_STEP;
    }
    return from + (part + 1) * (to - from) / parts;
}

static void turn_motor(int64_t now) {
    for (; motor_at + MOTOR_PERIOD <= now; motor_at += MOTOR_PERIOD) {
        motor_i.t = motor_at;
        motor_i.input = (motor_real)pulse_duty_of(compare[THRUST]);
        motor_step(&motor_p, &motor_s, &motor_i, &motor_o);
    }
}

uint16_t board_encoder(int64_t at) {
    turn_motor(at);
    return (uint16_t)motor_o.count;
}

void hardware_work(vehicle *v, int64_t now) {
    turn_motor(now);
    world_i.command.value.rudder_pulse = (world_real)pulse_seconds(compare[RUDDER]);
    world_i.command.value.speed_rpm = (world_real)motor_o.speed_rpm;
    world_i.command.valid = compare[RUDDER] != 0;
    for (int64_t t; (t = next_instant()) <= now; world_at = t) {
        world_i.t = world_i.command.t = world_at;
        world_i.h = t - world_at;
        world_i.fresh = true;
        world_i.is_held = !v->released;
        world_step(&world_p, &world_s, &world_i, &world_o);
        if (!world_i.first) ++part;
        world_i.first = false;
        if (link_heard(&v->link)) samples_send(&v->link, &world_o);
    }
}
