/* In the place of vehicle, sensors and actuators: the exported world in real time, behind actuators.c, which reads the
   servo timers' compare registers. With real hardware both go, and drivers come in their place. */
#include "actuators.h"
#include "instants.h"
#include "samples.h"
#include "vehicle.h"
#include "world.h"

#include "emulated.h"
#ifdef LOCKSTEP
#include "lockstep.h"
#endif

static world_params world_p;
static world_state world_s;
static world_in world_i;
static world_out world_o;
static uint16_t compare[CHANNELS];
static int64_t world_at, from, to;
static int64_t part, parts;

void board_pulse(int channel, uint16_t counts) {
    if (channel >= 0 && channel < CHANNELS) compare[channel] = counts;
}

const world_out *emulated_world(void) { return &world_o; }

const uint16_t *emulated_pulses(void) { return compare; }

motion hardware_motion(void) { return samples_motion(&world_o); }

void hardware_begin(void) {
    world_defaults(&world_p);
    world_init(&world_p, &world_s);
    actuators_begin();
    world_at = from = to = part = parts = 0;
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

void hardware_work(vehicle *v, int64_t now) {
    actuators_work(compare, now);
    actuators_command(compare, &world_i);
    for (int64_t t; (t = next_instant()) <= now; world_at = t) {
        world_i.t = world_i.command.t = world_at;
        world_i.h = t - world_at;
        world_i.fresh = true;
        world_i.is_held = !v->released;
        world_step(&world_p, &world_s, &world_i, &world_o);
        if (!world_i.first) ++part;
        world_i.first = false;
#ifdef LOCKSTEP
        lockstep_instant(v, t, &world_o);
#else
        if (link_heard(&v->link)) samples_send(&v->link, &world_o);
#endif
    }
}
