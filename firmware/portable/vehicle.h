/* The vehicle's end of the distributed autopilot: message master, failsafe, drive, servo frames.

   failsafe: the exported text of the block that the virtual vehicle runs too. */
#ifndef VEHICLE_H
#define VEHICLE_H
#include <stdbool.h>
#include <stdint.h>

#include "authority.h"
#include "rearm.h"
#include "port.h"
#include "drive.h"
#include "failsafe.h"
#include "link.h"

enum { MILLISECOND = 10000, SECOND = 1000 * MILLISECOND }; /* in units of 100 ns */
enum { TICK = MILLISECOND, SERVO = 20 * MILLISECOND, RECORD = 100 * MILLISECOND };
enum { DISARMED, COMPUTER, MANUAL, FAILSAFE };

typedef struct {
    uint32_t late;     /* ticks that did not begin in their own millisecond */
    uint32_t busy;     /* units of 100 ns worked since the last status */
    uint32_t longest;  /* tick so far */
} vehicle_load;

typedef struct {
    link link;
    failsafe_params failsafe_params;
    failsafe_state failsafe_state;
    failsafe_in failsafe_in;
    failsafe_out failsafe_out;
    drive drive;
    uint16_t pulses[CHANNELS];
    int64_t next_tick, next_frame, next_servo, next_quarter, next_record, next_moment, last_status;
    authority authority;
    rearm rearm;
    sender asker;
    bool asked;       /* to arm or disarm: answered after the tick */
    bool announced;   /* what the start came from was said */
    int64_t next_refusal, next_owner, next_text;
    uint32_t leading; /* commands refused so far, of a clock that is ahead */
    bool begun;       /* the failsafe has run since the start */
    bool released;    /* armed once since the start; an emulated vehicle is held until then */
    int listed;       /* parameters sent of a list that was asked for */
    vehicle_load load;
} vehicle;

void vehicle_begin(vehicle *v, const uint8_t key[KEY_SIZE], uint64_t build_stamp);

/* All that is to be done now: take what was received, and once a millisecond tick. Call it as often as possible. */
void vehicle_work(vehicle *v);

/* What stands between the portable part and the sensors: bring them to time `now`, send what they measured. */
void hardware_begin(void);
void hardware_work(vehicle *v, int64_t now);

/* How it moves by its own sensors: for the check that it is at rest before it is armed again after a failsafe. */
motion hardware_motion(void);

/* Parts of vehicle_work, in station.c: one message that was accepted; what is said each second, in three
   parts; a line for people. */
void station_hear(vehicle *v, int64_t now, const mavlink_message_t *message);
void station_answer(vehicle *v);
void station_refuse(vehicle *v, int64_t now); /* tell one whose clock or key is another */
void station_status(vehicle *v, int64_t now, int part);
void station_servos(vehicle *v, int64_t now);
void station_say(vehicle *v, uint8_t severity, const char *text);
void station_changed(vehicle *v);
#endif
