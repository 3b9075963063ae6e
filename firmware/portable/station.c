/* The standard protocol: heartbeat, arming, time synchronisation, servo outputs, status. */
#include <string.h>

#include "pulse.h"
#include "vehicle.h"

enum { CMD_ARM_DISARM = 400, ACCEPTED = 0, DENIED = 2, UNSUPPORTED = 3 };
enum { TYPE_SURFACE_BOAT = 11, TYPE_GCS = 6, AUTOPILOT_GENERIC = 0, CUSTOM_MODE = 1, ARMED_FLAG = 128, MANUAL_FLAG = 64 };
/* Modes as ground stations number them: the pilot, and the computer. */
enum { MODE_MANUAL = 0, MODE_COMPUTER = 15 };
enum { STANDBY = 3, ACTIVE = 4, CRITICAL = 5 };
enum { SEVERITY_CRITICAL = 2, SEVERITY_NOTICE = 5, SEVERITY_INFO = 6 };

static const char *const MODES[] = {"disarmed", "computer", "manual", "failsafe"};
static const char *const CAUSES[] = {"start", "arm request", "disarm request", "no command", "no command since arming",
                                     "takeover", "takeover ended", "pilot's radio lost"};

static const char *name(const char *const *names, int32_t k, int32_t n) { return k >= 0 && k < n ? names[k] : "?"; }

static void post(vehicle *v, const mavlink_message_t *message) {
    if (link_heard(&v->link)) link_send(&v->link, message);
}

#define SEND(v, kind, value)                                                                              \
    do {                                                                                                  \
        mavlink_message_t message_;                                                                       \
        mavlink_msg_##kind##_encode_status(SYSTEM, COMPONENT, &(v)->link.status, &message_, &(value));    \
        post(v, &message_);                                                                               \
    } while (0)

static uint16_t capped(uint32_t count) { return count > UINT16_MAX ? UINT16_MAX : (uint16_t)count; }

static void acknowledge(vehicle *v, uint16_t command, uint8_t result) {
    mavlink_command_ack_t ack = {0};
    ack.command = command;
    ack.result = result;
    ack.target_system = v->asked_system;
    ack.target_component = v->asked_component;
    SEND(v, command_ack, ack);
}

static void hear_command_long(vehicle *v, const mavlink_message_t *message) {
    mavlink_command_long_t c;
    mavlink_msg_command_long_decode(message, &c);
    if ((c.target_system && c.target_system != SYSTEM) || (c.target_component && c.target_component != COMPONENT)) return;
    v->asked_system = message->sysid;
    v->asked_component = message->compid;
    if (c.command != CMD_ARM_DISARM) {
        acknowledge(v, c.command, UNSUPPORTED);
    } else if (c.param1 == 1.0f || c.param1 == 0.0f) {
        v->failsafe_in.input.arm = c.param1 == 1.0f;
        v->failsafe_in.input.disarm = c.param1 == 0.0f;
        v->asked = true;
    } else {
        acknowledge(v, c.command, DENIED);
    }
}

void station_answer(vehicle *v) {
    v->asked = false;
    acknowledge(v, CMD_ARM_DISARM, ACCEPTED); /* neither is ever refused: arming while armed changes nothing */
}

static void hear_timesync(vehicle *v, int64_t now, const mavlink_message_t *message) {
    mavlink_timesync_t sync;
    mavlink_msg_timesync_decode(message, &sync);
    if (sync.tc1 != 0) return;
    sync.tc1 = now * 100;
    SEND(v, timesync, sync);
}

static void hear_drive_command(vehicle *v, const mavlink_message_t *message) {
    mavlink_command_t c;
    mavlink_msg_command_decode(message, &c);
    failsafe_in *in = &v->failsafe_in;
    in->input.command.t = c.t;
    in->input.command.valid = c.valid != 0;
    in->input.command.fresh = true;
    in->input.command.value.rudder_pulse = (failsafe_real)c.rudder_pulse;
    in->input.command.value.speed_rpm = (failsafe_real)c.speed_rpm;
}

void station_hear(vehicle *v, int64_t now, const mavlink_message_t *message) {
    switch (message->msgid) {
    case MAVLINK_MSG_ID_COMMAND: hear_drive_command(v, message); break;
    case MAVLINK_MSG_ID_TIMESYNC: hear_timesync(v, now, message); break;
    case MAVLINK_MSG_ID_COMMAND_LONG: hear_command_long(v, message); break;
    default: break; /* heartbeats, and what is for others */
    }
}

void station_servos(vehicle *v, int64_t now) {
    mavlink_servo_output_raw_t s = {0};
    s.time_usec = (uint32_t)(now / 10);
    s.servo1_raw = pulse_us(v->pulses[RUDDER]);
    s.servo2_raw = pulse_us(v->pulses[THRUST]);
    s.servo3_raw = pulse_us(v->pulses[LIFT]);
    SEND(v, servo_output_raw, s);
}

void station_say(vehicle *v, uint8_t severity, const char *text) {
    mavlink_statustext_t s = {0};
    s.severity = severity;
    size_t n = strlen(text);
    memcpy(s.text, text, n < sizeof s.text ? n : sizeof s.text);
    SEND(v, statustext, s);
}

enum { LINE = 50 };

/* A line put together piece by piece; what does not fit is cut off. */
typedef struct {
    char text[LINE + 1];
    size_t n;
} line;

static void add(line *l, const char *text) {
    while (*text && l->n < LINE) l->text[l->n++] = *text++;
}

static void add_number(line *l, uint32_t number) {
    char digits[11], *at = digits + sizeof digits - 1;
    *at = 0;
    do *--at = (char)('0' + number % 10);
    while (number /= 10);
    add(l, at);
}

void station_changed(vehicle *v) {
    line l = {0};
    const failsafe_out *out = &v->failsafe_out;
    add(&l, name(MODES, out->mode, 4));
    add(&l, ": ");
    add(&l, name(CAUSES, out->cause, 8));
    station_say(v, out->mode == FAILSAFE ? SEVERITY_CRITICAL : SEVERITY_NOTICE, l.text);
}

static void heartbeat(vehicle *v) {
    const failsafe_out *out = &v->failsafe_out;
    mavlink_heartbeat_t h = {0};
    h.type = TYPE_SURFACE_BOAT;
    h.autopilot = AUTOPILOT_GENERIC;
    h.base_mode = (uint8_t)(CUSTOM_MODE | (out->armed ? ARMED_FLAG : 0) | (out->mode == MANUAL ? MANUAL_FLAG : 0));
    h.custom_mode = out->mode == MANUAL ? MODE_MANUAL : MODE_COMPUTER;
    h.system_status = (uint8_t)(out->mode == FAILSAFE ? CRITICAL : out->armed ? ACTIVE : STANDBY);
    h.mavlink_version = 3;
    SEND(v, heartbeat, h);
}

static void statistics(vehicle *v, int64_t now) {
    const link_counts *c = &v->link.counts;
    mavlink_sys_status_t s = {0};
    int64_t passed = now - v->last_status;
    s.load = capped((uint32_t)((uint64_t)v->load.busy * 1000 / (uint64_t)(passed > 0 ? passed : 1)));
    s.voltage_battery = UINT16_MAX;
    s.current_battery = -1;
    s.battery_remaining = -1;
    s.errors_comm = capped(v->link.in.broken);
    s.errors_count1 = capped(c->unsigned_frames);
    s.errors_count2 = capped(c->forged + c->reflected);
    s.errors_count3 = capped(c->replayed);
    s.errors_count4 = capped(board_lost() + c->dropped);
    SEND(v, sys_status, s);
    v->last_status = now;
    v->load.busy = 0;
}

/* How it is with time and memory: ticks late, longest tick (us), stack (bytes), bytes that were in no frame. */
static void work_done(vehicle *v) {
    line l = {0};
    const struct {
        const char *name;
        uint32_t number;
    } said[] = {{"late ", v->load.late}, {" longest ", v->load.longest / 10}, {" stack ", board_stack()},
                {" skipped ", v->link.in.skipped}};
    for (unsigned i = 0; i < sizeof said / sizeof said[0]; ++i) {
        add(&l, said[i].name);
        add_number(&l, said[i].number);
    }
    station_say(v, SEVERITY_INFO, l.text);
}

void station_status(vehicle *v, int64_t now, int part) {
    if (part == 0) heartbeat(v);
    if (part == 1) statistics(v, now);
    if (part == 2 && now / SECOND % 5 == 0) work_done(v);
}
