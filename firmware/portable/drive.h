/* What stands between the failsafe and the pulses. Two are here, in the folder drives: the scenario's is copied to drive,
   with drive_state.h, what it remembers, and outputs.h, which outputs there are. */
#ifndef DRIVE_H
#define DRIVE_H
#include <stdbool.h>
#include <stdint.h>

#include "drive_state.h"
#include "failsafe.h"
#include "outputs.h"
#include "port.h"

/* Parameters that a ground station may set, DRIVE_PARAMETERS of them (outputs.h), kept in flash by their number. */
typedef struct {
    const char *name;
    float low, high;
} parameter;

extern const parameter drive_parameters[];
float drive_parameter(const drive *d, int k);
void drive_set_parameter(drive *d, int k, float value);

/* Parameters as exported; then, with those that were kept, the first state. */
void drive_defaults(drive *d);
void drive_begin(drive *d);

/* What the safety pilot's sticks ask for; us: NULL where no transmitter is heard. */
void drive_sticks(failsafe_in *in, const uint16_t *us);

/* Work up to time now, once a tick, on what the failsafe passes on. */
void drive_work(drive *d, const failsafe_out *out, int64_t now);

/* The pulses from now on; and whether nothing moves by those that are sent, so that a stop need not wait for a frame. */
void drive_pulses(const drive *d, const failsafe_out *out, uint16_t wanted[CHANNELS]);
bool drive_stands(const uint16_t pulses[CHANNELS]);

/* For the black box: three words. */
enum { DRIVE_WORDS = 3 };
void drive_record(const drive *d, const uint16_t pulses[CHANNELS], uint16_t age_ms, uint32_t words[DRIVE_WORDS]);

static inline uint32_t word_pair(int64_t low, int64_t high) { return ((uint32_t)low & 0xFFFFu) | (uint32_t)high << 16; }
#endif
