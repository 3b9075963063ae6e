#include "drive.h"

#include "output_table.h"
#include "pulse.h"

const parameter drive_parameters[] = {{"", 0.0f, 0.0f}};

/* There are none. */
float drive_parameter(const drive *d, int k) {
    (void)d, (void)k;
    return 0.0f;
}

void drive_set_parameter(drive *d, int k, float value) { (void)d, (void)k, (void)value; }

void drive_defaults(drive *d) { (void)d; }
void drive_begin(drive *d) { (void)d; }

/* A receiver with three channels flies no vehicle of any kind: whoever takes over stops it. */
void drive_sticks(failsafe_in *in, const uint16_t *us) {
    (void)us;
    output_rest(in);
}

void drive_work(drive *d, const failsafe_out *out, int64_t now) { (void)d, (void)out, (void)now; }

void drive_pulses(const drive *d, const failsafe_out *out, uint16_t wanted[CHANNELS]) {
    (void)d;
    for (int i = 0; i < CHANNELS; ++i) {
        const output_table *table = &output_tables[i];
        double value = output_value(out, i);
        bool commands = out->command.valid && value - value == 0; /* a number, and finite */
        wanted[i] = commands ? pulse_counts(pulse_line(table->values, table->counts, table->n, value)) : SAFE_PULSES[i];
    }
}

bool drive_stands(const uint16_t pulses[CHANNELS]) {
    bool stands = true;
    for (int i = 0; i < CHANNELS; ++i) stands = stands && pulses[i] == SAFE_PULSES[i];
    return stands;
}

static uint16_t pulse_at(const uint16_t pulses[CHANNELS], int i) { return i < CHANNELS ? pulses[i] : 0; }

/* The first four pulses; age of the command. */
void drive_record(const drive *d, const uint16_t pulses[CHANNELS], uint16_t age_ms, uint32_t words[DRIVE_WORDS]) {
    (void)d;
    words[0] = word_pair(pulse_at(pulses, 0), pulse_at(pulses, 1));
    words[1] = word_pair(pulse_at(pulses, 2), pulse_at(pulses, 3));
    words[2] = word_pair(0, age_ms);
}
