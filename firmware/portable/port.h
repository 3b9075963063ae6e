/* What the portable part asks of a board. A board file writes these functions; nothing else in it is called. */
#ifndef PORT_H
#define PORT_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "outputs.h" /* CHANNELS */

enum { RADIO_RUDDER, RADIO_THRUST, RADIO_MODE, RADIO_CHANNELS };
enum { RECORD_WORDS = 6 }; /* of the black box */

/* Time since the start, in units of 100 ns; never falls. */
int64_t board_now(void);

/* Hand bytes to the transmitter, all or none, without waiting; whether there was room. */
bool board_write(const uint8_t *bytes, size_t n);

/* A byte that was received; false where there is none. */
bool board_read(uint8_t *byte);

/* Bytes received and lost because nobody took them in time. */
uint32_t board_lost(void);

/* Sleep until an interrupt. */
void board_wait(void);

/* Set the width of a servo channel's pulses, in counts of 1/PULSE_HZ s (pulse.h), from the next frame on. */
void board_pulse(int channel, uint16_t counts);

/* The counter of the thrust fan's encoder, 16 bits, as a timer caught it at time `at`, which is not later than now. */
uint16_t board_encoder(int64_t at);

/* Pulse widths (us) from the safety pilot's receiver; false where it hears nothing. */
bool board_radio(uint16_t us[RADIO_CHANNELS]);

/* Keep a number over a loss of power; recall gives 0 where there is none. */
void board_remember(uint64_t number);
uint64_t board_recall(void);

/* Keep a parameter over a loss of power; load gives false where there is none. Only while disarmed. */
void board_store(int which, float value);
bool board_load(int which, float *value);

/* Where the key was put, apart from the program (key.h); NULL where there is no such place. */
const uint8_t *board_key(void);

/* Put the hardware watchdog off by its period. Called once a tick, when all of its work was done. */
void board_kick(void);

/* What the start came from, a word or two: "power on", "watchdog". */
const char *board_cause(void);

/* Why the board must not be armed, a word or two; NULL where it may be. */
const char *board_refusal(void);

/* Keep a record of the flight for who looks for the cause of an accident; dropped where there is no room. */
void board_record(const uint32_t record[RECORD_WORDS]);

/* Called once a second while disarmed: time for what takes long, such as erasing flash. */
void board_rest(void);

/* Most bytes of stack used so far. */
uint32_t board_stack(void);
#endif
