/* The hardware of a vehicle: pulses out, the fan's encoder in, samples of the inertial sensor to the autopilot, and those
   of a slave controller's ultrasonic units, where the scenario has any.

   The chip is mounted with x forward and y to port, so z up; the vehicle's axes are forward, starboard, down. Between two
   of the scenario's samples the chip's are averaged. Sensors of the scenario that are not on this board stay silent:
   the autopilot's checks before arming see that. */
#include "board.h"
#include "icm42688.h"
#include "ping.h"
#include "samples.h"
#include "vehicle.h"

#ifndef SAMPLES_IMU
#error "This board measures the sensor 'imu', which the scenario has not: try --set navigation=ins, or make WORLD=1"
#endif

static icm42688 chip;
static world_out samples;
static float force[3], rate[3];
static uint32_t n;
static bool force_saturated, rate_saturated;

void board_pulse(int channel, uint16_t counts) { servo_set(channel, counts); }
uint16_t board_encoder(int64_t at) { return encoder_count(at); }

static void empty(void) {
    for (int i = 0; i < 3; ++i) force[i] = rate[i] = 0;
    n = 0;
    force_saturated = rate_saturated = false;
}

#ifdef SAMPLES_RANGING
static const int BEACONS = (int)(sizeof samples.sensors.ranging.value.range / sizeof samples.sensors.ranging.value.range[0]);
static piece_assembler pieces;

static void send_ping(vehicle *v, const ping *p) {
    for (int i = 0; i < BEACONS; ++i) {
        samples.sensors.ranging.value.range[i] = 0;
        samples.sensors.ranging.value.arrived[i] = false;
    }
    for (int i = 0; i < p->n; ++i) {
        int beacon = p->replies[i].beacon;
        if (beacon >= BEACONS) continue;
        samples.sensors.ranging.value.range[beacon] = (world_real)ping_range(&p->replies[i]);
        samples.sensors.ranging.value.arrived[beacon] = true;
    }
    samples.sensors.ranging.value.unit = p->unit;
    samples.sensors.ranging.t = p->at;
    samples.sensors.ranging.fresh = samples.sensors.ranging.valid = true;
    if (link_heard(&v->link)) samples_send(&v->link, &samples);
    samples.sensors.ranging.fresh = false;
}

/* The slave's pings to the autopilot; and whether the lift fan is to turn to the slave, which believes no word twice. */
static void work_bus(vehicle *v) {
    static uint8_t count;
    uint8_t word[MESSAGE_MOST], data[LIFT_DATA];
    bus_message m;
    ping heard;
    piece p;
    while (bus_take(&p)) {
        pieces_put(&pieces, &p);
        while (pieces_message(&pieces, &m))
            if (ping_unpack(&m, &heard)) send_ping(v, &heard);
    }
    data[0] = v->failsafe_out.lift ? 1 : 0;
    data[1] = ++count;
    bus_answer(word, message_pack(MESSAGE_LIFT, data, sizeof data, word));
}
#else
static void work_bus(vehicle *v) { (void)v; }
#endif

motion hardware_motion(void) { return samples_motion(&samples); }

void hardware_begin(void) {
#ifdef SAMPLES_RANGING
    bus_begin();
#endif
    spi_begin();
    icm_begin(&chip, board_now());
    empty();
}

static void add(const icm_sample *s) {
    for (int i = 0; i < 3; ++i) {
        force[i] += s->force[i];
        rate[i] += s->rate[i];
    }
    ++n;
    force_saturated = force_saturated || s->force_saturated;
    rate_saturated = rate_saturated || s->rate_saturated;
}

static void send(vehicle *v, int64_t t) {
    static const float TURNED[3] = {1, -1, -1};
    for (int i = 0; i < 3; ++i) {
        samples.sensors.imu.value.specific_force[i] = (world_real)(TURNED[i] * force[i] / (float)n);
        samples.sensors.imu.value.angular_rate[i] = (world_real)(TURNED[i] * rate[i] / (float)n);
    }
    samples.sensors.imu.value.accelerometer_saturated = force_saturated;
    samples.sensors.imu.value.gyro_saturated = rate_saturated;
    samples.sensors.imu.t = t;
    samples.sensors.imu.fresh = samples.sensors.imu.valid = true;
    if (link_heard(&v->link)) samples_send(&v->link, &samples);
    samples.sensors.imu.fresh = false;
    empty();
}

void hardware_work(vehicle *v, int64_t now) {
    static int64_t next;
    icm_sample s;
    if (icm_work(&chip, now, &s)) add(&s);
    board_refuse(icm_good(&chip) ? NULL : "inertial sensor");
    work_bus(v);
    if (now < next) return;
    if (n > 0u) send(v, now / SAMPLES_IMU * SAMPLES_IMU);
    next = (now / SAMPLES_IMU + 1) * SAMPLES_IMU;
}
