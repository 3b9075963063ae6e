/* The firmware: everything happens in vehicle_work, called again whenever the processor wakes. A board without a key
   hears and says nothing; its servos stay neutral. */
#include "key.h"
#include "vehicle.h"

void run(void);

void run(void) {
    static vehicle v;
    static vehicle_key key;
    bool keyed = key_read(board_key(), &key);
    hardware_begin();
    vehicle_begin(&v, key.secret, key.since);
    for (;;) {
        if (keyed) vehicle_work(&v);
        else board_kick();
        board_wait();
    }
}
