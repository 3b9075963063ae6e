/* The firmware: everything happens in vehicle_work, called again whenever the processor wakes. */
#include "key.h"
#include "vehicle.h"

void run(void);

void run(void) {
    static vehicle v;
    static const uint8_t key[KEY_SIZE] = {KEY};
    hardware_begin();
    vehicle_begin(&v, key, BUILD_STAMP);
    for (;;) {
        vehicle_work(&v);
        board_wait();
    }
}
