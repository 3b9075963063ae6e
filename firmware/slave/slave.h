/* The second controller of the vehicle: lift fan and two ultrasonic units. It is the master of the bus, for what is urgent
   goes from here to the other controller.

   Source: Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, chapter 5: its
   duties, and that it polls one unit 100 ms after the other. Times else are reconstructed. */
#ifndef SLAVE_H
#define SLAVE_H
#include <stdbool.h>
#include <stdint.h>

#include "cricket.h"
#include "pieces.h"
#include "ping.h"

enum { SLAVE_TICK = 10000, SLAVE_POLL = 1000000, SLAVE_SERVO = 200000, SLAVE_PATIENCE = 2500000 };
enum { SLAVE_WORD = LIFT_DATA + 4 }; /* bytes of what the other controller says each slot */

typedef struct {
    cricket units[PING_UNITS];
    ping open; /* replies to the ping under way */
    bool has_pinged;
    piece_queue queue;
    int64_t next_tick, next_poll, next_slot, next_servo;
    int64_t heard; /* when the other controller last said something new */
    bool has_heard;
    uint8_t count; /* of its words */
    bool lift;     /* what it asked for last */
    uint16_t pulse;
    uint32_t unacknowledged; /* pieces that nobody took */
} slave;

void slave_begin(slave *s);

/* All that is to be done now. Call it as often as possible. */
void slave_work(slave *s);
#endif
