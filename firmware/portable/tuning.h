/* Parameters that a ground station reads and sets: gains and limits of the speed regulator, within their bounds, kept by the
   board over a loss of power. While the vehicle is armed none is changed. */
#ifndef TUNING_H
#define TUNING_H
#include "vehicle.h"

/* What was kept takes the place of the defaults; what is out of its bounds does not. */
void tuning_begin(vehicle *v);

/* PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; whether the message was one of them. */
bool tuning_hear(vehicle *v, const mavlink_message_t *message);

/* Send the next of a list that was asked for; called each millisecond. */
void tuning_work(vehicle *v);
#endif
