/* What the files of this board are to each other. What the portable part sees of them is in port.h. */
#ifndef BOARD_H
#define BOARD_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "pieces.h"

enum { CORE_HZ = 168000000, APB2_HZ = 84000000 }; /* the timers' 84 MHz come from the Makefile: the emulator has another */

/* clock.c: 168 MHz from the crystal, or from the chip's own oscillator where it does not start; whether by the crystal. */
bool clock_begin(void);

/* watchdog.c: the independent watchdog. It can't be stopped again; patience for an erasure, and back. */
enum { WATCHDOG_SHORT = 400, WATCHDOG_LONG = 2000 }; /* counts, see watchdog.c */
void watchdog_begin(void);
void watchdog_period(uint32_t counts, bool patient);
void watchdog_kick(void);
void brown_out_begin(void);
const char *reset_cause(void);

/* board.c, of each role its own */
void board_begin(bool by_crystal);
void board_refuse(const char *reason);
void board_ticked(void);

/* program.c */
__attribute__((noreturn)) void board_reset(void);

/* time.c */
void time_begin(void);
uint32_t mask_interrupts(void);
void restore_interrupts(uint32_t before);

/* usart.c */
void usart_begin(void);
bool usart_write(const uint8_t *bytes, size_t n);
bool usart_read(uint8_t *byte);
bool usart_waiting(void);
uint32_t usart_lost(void);
void usart_interrupt(void);
void usart_lapped(void);
void usart_sent(void);

/* servo.c: pulses of timer 3. Silence is no pulse at all, which a speed controller takes for a stop. */
void servo_begin(void);
void servo_set(int channel, uint16_t counts);
void servo_silence(void);

/* receiver.c: pulses of the safety pilot's receiver, caught by timer 5; encoder.c: edges counted by timer 4. */
void receiver_begin(void);
void receiver_captured(void);
void receiver_tick(void);
bool receiver_read(uint16_t us[]);
void encoder_begin(void);
void encoder_catch(int64_t now);
uint16_t encoder_count(int64_t at);

/* spi.c */
void spi_begin(void);

/* The bus between two controllers. bus_device.c: the end that is addressed; slave/bus_master.c: the other. */
void bus_begin(void);
bool bus_take(piece *to);
void bus_answer(const uint8_t *bytes, size_t n);
void bus_event(void);
void bus_error(void);

/* slave/units.c: the ultrasonic units' lines. */
void units_begin(void);
bool units_waiting(void);
void unit_interrupt_0(void);
void unit_interrupt_1(void);

/* storage.c: the journals in flash. */
void storage_begin(void);
uint32_t storage_failures(void);
#endif
