/* Servos and speed controllers that read the pulses by the same tables: what the exported world is told. */
#include "actuators.h"
#include "output_table.h"
#include "pulse.h"

void actuators_begin(void) {}

void actuators_work(const uint16_t pulses[CHANNELS], int64_t now) { (void)pulses, (void)now; }

void actuators_command(const uint16_t pulses[CHANNELS], world_in *world) {
    world->command.valid = true;
    for (int i = 0; i < CHANNELS; ++i) {
        const output_table *table = &output_tables[i];
        output_tell(world, i, pulse_line(table->counts, table->values, table->n, pulses[i]));
        world->command.valid = world->command.valid && pulses[i] != 0;
    }
}
