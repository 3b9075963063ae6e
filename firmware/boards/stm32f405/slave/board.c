/* The functions of slave_port.h that need no driver of their own, and the start of all drivers. */
#include "board.h"
#include "port.h"
#include "registers.h"
#include "slave_port.h"

#ifndef HAS_LIFT
#error "A second controller drives a lift fan, which this vehicle has not: leave ROLE=slave out"
#endif

static volatile bool ticked;

void board_ticked(void) { ticked = true; }

/* The lift fan first, so that it hears a pulse that stops it as soon as may be. */
void board_begin(bool by_crystal) {
    (void)by_crystal; /* a slave without its crystal is 1 % off in its times of flight, and flies */
    servo_begin();
    watchdog_begin();
    brown_out_begin();
    time_begin();
    units_begin();
    bus_begin();
}

int64_t slave_now(void) { return board_now(); }
void slave_lift(uint16_t counts) { servo_set(LIFT, counts); }
void slave_kick(void) { watchdog_kick(); }

#ifndef REGISTER_MODEL
/* With interrupts masked, one that comes after the look still wakes the processor. */
void slave_wait(void) {
    uint32_t before = mask_interrupts();
    if (!units_waiting() && !ticked) __asm volatile("dsb\n wfi" ::: "memory");
    ticked = false;
    restore_interrupts(before);
}
#endif
