/* The functions of port.h that need no driver of their own, and the start of all drivers. */
#include "board.h"
#include "port.h"
#include "registers.h"

static volatile bool ticked;
static bool crystal; /* whether it drives the clock */
static const char *cause, *refusal;

void board_ticked(void) {
    encoder_catch(board_now());
    receiver_tick();
    ticked = true;
}

bool board_write(const uint8_t *bytes, size_t n) { return usart_write(bytes, n); }
bool board_read(uint8_t *byte) { return usart_read(byte); }
uint32_t board_lost(void) { return usart_lost(); }
bool board_radio(uint16_t us[RADIO_CHANNELS]) { return receiver_read(us); }

/* Servos first, so that they hear neutral pulses as soon as may be; then the watchdog, and what may take long. */
void board_begin(bool by_crystal) {
    crystal = by_crystal;
    cause = reset_cause();
    servo_begin();
    watchdog_begin();
    brown_out_begin();
    time_begin();
    receiver_begin();
    encoder_begin();
    usart_begin();
    storage_begin();
}

const char *board_cause(void) { return cause; }

void board_refuse(const char *reason) { refusal = reason; }

const char *board_refusal(void) {
    if (!crystal) return "no crystal";
    if (storage_failures() != 0u) return "storage";
    return refusal;
}

#ifndef REGISTER_MODEL
/* With interrupts masked, one that comes after the look still wakes the processor. */
void board_wait(void) {
    uint32_t before = mask_interrupts();
    if (!usart_waiting() && !ticked) __asm volatile("dsb\n wfi" ::: "memory");
    ticked = false;
    restore_interrupts(before);
}
#endif
