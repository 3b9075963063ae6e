#include "icm42688.h"

#include <string.h>

enum { DEVICE_CONFIG = 0x11, TEMP_DATA1 = 0x1D, INT_STATUS = 0x2D, PWR_MGMT0 = 0x4E, GYRO_CONFIG0 = 0x4F };
enum { ACCEL_CONFIG0 = 0x50, WHO_AM_I = 0x75, READ = 0x80 };
enum { SOFT_RESET = 1, BOTH_LOW_NOISE = 0x0F, DATA_READY = 8, IDENTITY = 0x47 };
enum { RATE_500 = 2 << 5, FORCE_4G = 2 << 5, ODR_1000 = 6 }; /* 500 deg/s, 4 g, 1 kHz */
enum { MS = 10000, RESET_TIME = 2 * MS, START_TIME = 50 * MS, SILENCE = 10 * MS, AGAIN = 1000 * MS, FROZEN = 50 };
enum { NO_DATA = -32768 };

static const float FORCE_STEP = 9.80665f / 8192.0f;                 /* 4 g: 8192 counts a g */
static const float RATE_STEP = 3.14159265f / 180.0f * 500.0f / 32768.0f; /* 500 deg/s: 65.5 counts a deg/s */

static bool set_register(uint8_t address, uint8_t value) {
    uint8_t bytes[2] = {address, value};
    return spi_exchange(bytes, sizeof bytes);
}

static bool get_register(uint8_t address, uint8_t *value) {
    uint8_t bytes[2] = {(uint8_t)(READ | address), 0};
    bool good = spi_exchange(bytes, sizeof bytes);
    *value = bytes[1];
    return good;
}

static void go(icm42688 *d, int phase, int64_t until) {
    d->phase = phase;
    d->until = until;
}

void icm_begin(icm42688 *d, int64_t now) {
    memset(d, 0, sizeof *d);
    (void)set_register(DEVICE_CONFIG, SOFT_RESET);
    go(d, ICM_RESETTING, now + RESET_TIME);
}

static bool fail(icm42688 *d, int64_t now) {
    d->faults++;
    go(d, ICM_FAILED, now + AGAIN);
    return false;
}

static bool is_there(void) {
    uint8_t identity;
    return get_register(WHO_AM_I, &identity) && identity == IDENTITY;
}

/* Ranges and rates first: after the power modes no register may be written for 200 us (14.36). */
static bool configure(void) {
    return is_there() && set_register(GYRO_CONFIG0, RATE_500 | ODR_1000) && set_register(ACCEL_CONFIG0, FORCE_4G | ODR_1000) &&
           set_register(PWR_MGMT0, BOTH_LOW_NOISE);
}

static bool is_configured(void) {
    uint8_t power, rate, force;
    return get_register(PWR_MGMT0, &power) && get_register(GYRO_CONFIG0, &rate) && get_register(ACCEL_CONFIG0, &force) &&
           power == BOTH_LOW_NOISE && rate == (RATE_500 | ODR_1000) && force == (FORCE_4G | ODR_1000);
}

static int16_t big(const uint8_t *bytes) { return (int16_t)((uint16_t)bytes[0] << 8 | bytes[1]); }

/* Counts to units; whether one stands at an end of its range. */
static bool scale(const uint8_t *bytes, float step, float to[3]) {
    bool saturated = false;
    for (int i = 0; i < 3; ++i) {
        int16_t counts = big(bytes + 2 * i);
        saturated = saturated || counts >= 32767 || counts <= -32767;
        to[i] = (float)counts * step;
    }
    return saturated;
}

static bool has_data(const uint8_t *bytes) {
    for (int i = 0; i < 6; ++i)
        if (big(bytes + 2 * i) != NO_DATA) return true;
    return false;
}

static bool read_sample(icm42688 *d, int64_t now, icm_sample *to) {
    uint8_t bytes[15] = {READ | TEMP_DATA1};
    uint8_t *axes = bytes + 3;
    if (!spi_exchange(bytes, sizeof bytes)) return fail(d, now);
    if (!has_data(axes)) return false;
    d->same = memcmp(axes, d->before, sizeof d->before) == 0 ? d->same + 1u : 0u;
    if (d->same >= (uint32_t)FROZEN) return fail(d, now);
    memcpy(d->before, axes, sizeof d->before);
    d->last = now;
    to->temperature = (float)big(bytes + 1) / 132.48f + 25.0f;
    to->force_saturated = scale(axes, FORCE_STEP, to->force);
    to->rate_saturated = scale(axes + 6, RATE_STEP, to->rate);
    return true;
}

static bool run_on(icm42688 *d, int64_t now, icm_sample *to) {
    uint8_t status;
    if (!get_register(INT_STATUS, &status)) return fail(d, now);
    if ((status & DATA_READY) && status != 0xFFu) return read_sample(d, now, to);
    if (now - d->last < SILENCE) return false;
    return fail(d, now);
}

bool icm_work(icm42688 *d, int64_t now, icm_sample *to) {
    uint32_t faults = d->faults;
    if (d->phase == ICM_RUNNING) return run_on(d, now, to);
    if (now < d->until) return false;
    switch (d->phase) {
    case ICM_RESETTING:
        if (!configure()) return fail(d, now);
        go(d, ICM_STARTING, now + START_TIME);
        break;
    case ICM_STARTING:
        if (!is_configured()) return fail(d, now);
        d->last = now;
        d->same = 0;
        go(d, ICM_RUNNING, now);
        break;
    default:
        icm_begin(d, now);
        d->faults = faults;
        break;
    }
    return false;
}

bool icm_good(const icm42688 *d) { return d->phase == ICM_RUNNING; }
