/* TDK InvenSense ICM-42688-P, three gyros and three accelerometers, over SPI; nothing in it waits.

   Source: data sheet DS-000347 rev. 1.7: registers of bank 0 (14), start-up times (3.1, 3.2, table 8), SPI (9). */
#ifndef ICM42688_H
#define ICM42688_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { ICM_RESETTING, ICM_STARTING, ICM_RUNNING, ICM_FAILED };

typedef struct {
    float force[3];   /* m/s^2, along the chip's axes */
    float rate[3];    /* rad/s */
    float temperature; /* deg C */
    bool force_saturated, rate_saturated;
} icm_sample;

typedef struct {
    int phase;
    int64_t until;      /* when the phase is over, 100 ns */
    int64_t last;       /* when a sample last came */
    uint8_t before[12]; /* it, as it was read */
    uint32_t same;      /* samples in a row that were equal to the bit */
    uint32_t faults;    /* times that it was started anew */
} icm42688;

/* The board's: exchange n bytes with the chip selected; whether the bus did. */
bool spi_exchange(uint8_t *bytes, size_t n);

void icm_begin(icm42688 *d, int64_t now);

/* Go on: start the chip, and take a sample if one is ready; whether there is one. A chip that is another one, silent for
   10 ms, frozen for 50 samples or whose settings are gone is started anew, a second later. Call it each millisecond. */
bool icm_work(icm42688 *d, int64_t now, icm_sample *to);

bool icm_good(const icm42688 *d);
#endif
