#include "lockstep.h"

#include "instants.h"
#include "port.h"
#include "samples.h"
#include "standing_clock.h"

static world_out unsent; /* newest samples, fresh until they are sent */

/* Take what has come; whether the command of time t was in it. */
static bool hear(vehicle *v, int64_t t) {
    uint8_t byte;
    bool came = false;
    while (board_read(&byte)) {
        mavlink_message_t message;
        link_take(&v->link, byte);
        while (link_next(&v->link, t, &message)) {
            station_hear(v, t, &message);
            came |= message.msgid == MAVLINK_MSG_ID_COMMAND && mavlink_msg_command_get_t(&message) == t;
        }
    }
    return came;
}

void lockstep_instant(vehicle *v, int64_t t, const world_out *out) {
    samples_merge(&unsent, out);
    if (t % AUTOPILOT_PERIOD != 0) return;
    if (t >= DURATION) board_end();
    for (; !link_heard(&v->link); (void)hear(v, t)) board_idle();
    mavlink_instant_t instant = {0};
    mavlink_message_t message;
    instant.t = t;
    instant.samples = samples_send(&v->link, &unsent);
    samples_merge(&unsent, NULL);
    mavlink_msg_instant_encode_status(SYSTEM, COMPONENT, &v->link.status, &message, &instant);
    link_send(&v->link, &message);
    while (!hear(v, t)) board_idle();
}
