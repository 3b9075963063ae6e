/* The program that flies, on the registers' model: main.c with the loop turned by the test. */
#include "board.h"
#include "vehicle.h"

static vehicle v;

void flight_begin(const uint8_t *key, uint64_t since) {
    board_begin(clock_begin());
    hardware_begin();
    vehicle_begin(&v, key, since);
}

void flight_work(void) { vehicle_work(&v); }
uint32_t board_stack(void) { return 0; }
