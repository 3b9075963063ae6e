/* Functions that a board must provide for the portable part. No other function of a board's file is called. */
#ifndef PORT_H
#define PORT_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "outputs.h" /* CHANNELS */

enum { RADIO_RUDDER, RADIO_THRUST, RADIO_MODE, RADIO_CHANNELS };
enum { RECORD_WORDS = 6 }; /* of the black box */

/* Time since the start, in units of 100 ns. It never decreases. */
int64_t board_now(void);

/* Send all of the bytes or none, without waiting. Return true if the buffer had room for them. */
bool board_write(const uint8_t *bytes, size_t n);

/* Read a received byte. Return false if no byte was received. */
bool board_read(uint8_t *byte);

/* Number of received bytes that were lost because they were not read in time. */
uint32_t board_lost(void);

/* Sleep until an interrupt. */
void board_wait(void);

/* Set the width of a servo channel's pulses, in counts of 1/PULSE_HZ s (pulse.h), from the next frame on. */
void board_pulse(int channel, uint16_t counts);

/* The 16-bit count of the thrust fan's encoder that a timer captured at time `at`, which is not later than now. */
uint16_t board_encoder(int64_t at);

/* Pulse widths (us) from the safety pilot's receiver. Return false if no pulses are received. */
bool board_radio(uint16_t us[RADIO_CHANNELS]);

/* Store a number so that it survives a loss of power, and read it. Without a stored number, recall returns 0. */
void board_remember(uint64_t number);
uint64_t board_recall(void);

/* Store a parameter so that it survives a loss of power, while disarmed only. Load returns false if none is stored. */
void board_store(int which, float value);
bool board_load(int which, float *value);

/* Address of the key, which is stored apart from the program (key.h); NULL if the board has no such memory. */
const uint8_t *board_key(void);

/* Reset the timer of the hardware watchdog. Called once per tick, when all work of the tick is done. */
void board_kick(void);

/* Cause of the last start in one or two words: "power on", "watchdog". */
const char *board_cause(void);

/* Reason in one or two words why the board must not be armed; NULL if it may be armed. */
const char *board_refusal(void);

/* Store a record of the flight in the black box. The record is dropped if the black box is full. */
void board_record(const uint32_t record[RECORD_WORDS]);

/* Do slow work, such as erasing flash. Called once a second while disarmed. */
void board_rest(void);

/* Largest number of bytes of stack used so far. */
uint32_t board_stack(void);
#endif
