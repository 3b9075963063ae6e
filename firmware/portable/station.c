/* The standard protocol: heartbeat, arming, time synchronisation, servo outputs, status. */
#include <string.h>

#include "command.h"
#include "identity.h"
#include "pulse.h"
#include "tuning.h"
#include "vehicle.h"

enum { CMD_ARM_DISARM = 400, CMD_REQUEST_CONTROL = 32100, ACCEPTED = 0, REJECTED = 1, DENIED = 2, UNSUPPORTED = 3 };
enum { AUTOPILOT_GENERIC = 0, CUSTOM_MODE = 1, ARMED_FLAG = 128, MANUAL_FLAG = 64 };
enum { CONFIRMATION = 21196 }; /* param2 of an order to arm: armed again after a failsafe */
enum { MOST_COMMAND_LEAD = 200 * MILLISECOND };
/* Modes as ground stations number them: the pilot, and the computer. */
enum { MODE_MANUAL = 0, MODE_COMPUTER = 15 };
enum { STANDBY = 3, ACTIVE = 4, CRITICAL = 5 };
enum { SEVERITY_CRITICAL = 2, SEVERITY_WARNING = 4, SEVERITY_NOTICE = 5, SEVERITY_INFO = 6 };

static const char *const MODES[] = {"disarmed", "computer", "manual", "failsafe"};
static const char *const CAUSES[] = {"start", "arm request", "disarm request", "no command", "no command since arming",
                                     "takeover", "takeover ended", "pilot's radio lost", "fence", "envelope"};

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

/* to: NULL for all on the line. */
static void acknowledge(vehicle *v, const sender *to, uint16_t command, uint8_t result) {
    mavlink_command_ack_t ack = {0};
    ack.command = command;
    ack.result = result;
    if (command == CMD_ARM_DISARM || command == CMD_REQUEST_CONTROL)
        ack.result_param2 = v->authority.owned ? (int32_t)v->authority.owner.session : 0;
    if (to) {
        ack.target_system = to->system;
        ack.target_component = to->component;
    }
    SEND(v, command_ack, ack);
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

static void say_two(vehicle *v, uint8_t severity, const char *first, const char *second) {
    line l = {0};
    add(&l, first);
    add(&l, second);
    station_say(v, severity, l.text);
}

static const char *arming_refusal(const vehicle *v, bool confirms) {
    const char *why = board_refusal();
    return why != NULL ? why : rearm_refusal(&v->rearm, confirms);
}

/* A person's hand, which has no session, confirms by disarming; a program confirms with the order itself. */
static void hear_arming(vehicle *v, const sender *s, float arm, float confirmation) {
    if ((arm != 1.0f && arm != 0.0f) || !authority_allows(&v->authority, s)) {
        acknowledge(v, s, CMD_ARM_DISARM, DENIED);
        return;
    }
    bool confirms = confirmation == (float)CONFIRMATION;
    if (arm == 0.0f && s->session == 0u) rearm_confirm(&v->rearm);
    if (arm == 1.0f && !v->failsafe_out.armed && arming_refusal(v, confirms) != NULL) {
        acknowledge(v, s, CMD_ARM_DISARM, REJECTED);
        say_two(v, SEVERITY_CRITICAL, "not armed: ", arming_refusal(v, confirms));
        return;
    }
    if (arm == 1.0f) authority_arm(&v->authority, s);
    v->failsafe_in.input.arm = arm == 1.0f;
    v->failsafe_in.input.disarm = arm == 0.0f;
    v->asker = *s;
    v->asked = true;
}

static void hear_command_long(vehicle *v, const mavlink_message_t *message) {
    mavlink_command_long_t c;
    mavlink_msg_command_long_decode(message, &c);
    if ((c.target_system && c.target_system != SYSTEM) || (c.target_component && c.target_component != COMPONENT)) return;
    sender s = {message->sysid, message->compid, message->signature[0], authority_session(c.command == CMD_ARM_DISARM ? c.param3 : c.param5)};
    float addressed = c.command == CMD_ARM_DISARM ? c.param4 : c.command == CMD_REQUEST_CONTROL ? c.param6 : 0.0f;
    if (authority_session(addressed) != 0u) return; /* another vehicle is meant: this one draws no session */
    if (c.command == CMD_ARM_DISARM) {
        hear_arming(v, &s, c.param1, c.param2);
    } else if (c.command == CMD_REQUEST_CONTROL && c.param2 == 1.0f && s.session != 0u) {
        authority_hand_over(&v->authority, &s);
        acknowledge(v, &s, c.command, ACCEPTED);
    } else {
        acknowledge(v, &s, c.command, UNSUPPORTED);
    }
}

void station_answer(vehicle *v) {
    v->asked = false;
    acknowledge(v, &v->asker, CMD_ARM_DISARM, ACCEPTED); /* arming while armed changes nothing */
}

void station_refuse(vehicle *v, int64_t now) {
    v->link.refusal.due = false;
    if (now < v->next_refusal) return;
    v->next_refusal = now + SECOND / 5;
    mavlink_timesync_t sync = {0};
    sync.tc1 = now * 100 + 1;
    sync.ts1 = v->link.refusal.asked;
    mavlink_message_t message;
    mavlink_msg_timesync_encode_status(SYSTEM, COMPONENT, &v->link.status, &message, &sync);
    link_send(&v->link, &message); /* also before somebody was believed: what is stored may be ahead of all */
}

static void hear_timesync(vehicle *v, int64_t now, const mavlink_message_t *message) {
    mavlink_timesync_t sync;
    mavlink_msg_timesync_decode(message, &sync);
    if (sync.tc1 != 0) return;
    sync.tc1 = now * 100;
    SEND(v, timesync, sync);
}

/* A line on what commands are refused, each five seconds at most; whose the vehicle is, each second. */
static void refuse_command(vehicle *v, int64_t now, const char *why) {
    if (now >= v->next_text) {
        v->next_text = now + 5 * SECOND;
        station_say(v, SEVERITY_WARNING, why);
    }
    if (now >= v->next_owner) {
        v->next_owner = now + SECOND;
        acknowledge(v, NULL, CMD_REQUEST_CONTROL, ACCEPTED);
    }
}

/* A command that leads our clock is of another: the failsafe would take none until its time. */
static void hear_drive_command(vehicle *v, int64_t now, const mavlink_message_t *message) {
    mavlink_command_t c;
    mavlink_msg_command_decode(message, &c);
    sender s = {message->sysid, message->compid, message->signature[0], c.session};
    if (!authority_admits(&v->authority, &s)) {
        refuse_command(v, now, "commands without authority refused");
        return;
    }
    if (c.t > now + MOST_COMMAND_LEAD) {
        v->leading++;
        refuse_command(v, now, "commands of another clock refused");
        return;
    }
    failsafe_in *in = &v->failsafe_in;
    in->input.command.t = c.t;
    in->input.command.valid = c.valid != 0;
    in->input.command.fresh = true;
    command_take(in, &c);
}

enum { IDENTITY_REQUEST = 0xF474, IDENTITY_LINE = 0xF475, IDENTITY_HEAD = 4 + IDENTITY_DIGEST };

/* Which scenario and numbers it was built for, a line at a time, as trimtab.flight.station.identity asks for them. */
static void hear_tunnel(vehicle *v, const mavlink_message_t *message) {
    mavlink_tunnel_t t, answer = {0};
    mavlink_msg_tunnel_decode(message, &t);
    if (t.payload_type != IDENTITY_REQUEST || (t.target_system && t.target_system != SYSTEM)) return;
    uint16_t index = (uint16_t)(t.payload[0] | t.payload[1] << 8);
    if (index >= identity_lines) index = (uint16_t)(identity_lines - 1);
    const char *line = identity_line[index];
    size_t n = strlen(line), room = sizeof answer.payload - IDENTITY_HEAD;
    if (n > room) n = room;
    answer.payload[0] = (uint8_t)identity_lines;
    answer.payload[1] = (uint8_t)(identity_lines >> 8);
    answer.payload[2] = (uint8_t)index;
    answer.payload[3] = (uint8_t)(index >> 8);
    memcpy(answer.payload + 4, identity_digest, IDENTITY_DIGEST);
    memcpy(answer.payload + IDENTITY_HEAD, line, n);
    answer.target_system = message->sysid;
    answer.target_component = message->compid;
    answer.payload_type = IDENTITY_LINE;
    answer.payload_length = (uint8_t)(IDENTITY_HEAD + n);
    SEND(v, tunnel, answer);
}

void station_hear(vehicle *v, int64_t now, const mavlink_message_t *message) {
    if (tuning_hear(v, message)) return;
    switch (message->msgid) {
    case MAVLINK_MSG_ID_COMMAND: hear_drive_command(v, now, message); break;
    case MAVLINK_MSG_ID_TIMESYNC: hear_timesync(v, now, message); break;
    case MAVLINK_MSG_ID_TUNNEL: hear_tunnel(v, message); break;
    case MAVLINK_MSG_ID_COMMAND_LONG: hear_command_long(v, message); break;
    default: break; /* heartbeats, and what is for others */
    }
}

enum { SERVOS = 8 }; /* that the message has: trimtab firmware writes no more outputs */

void station_servos(vehicle *v, int64_t now) {
    mavlink_servo_output_raw_t s = {0};
    s.time_usec = (uint32_t)(now / 10);
    uint16_t us[SERVOS] = {0};
    for (int i = 0; i < CHANNELS; ++i) us[i] = pulse_us(v->pulses[i]);
    s.servo1_raw = us[0];
    s.servo2_raw = us[1];
    s.servo3_raw = us[2];
    s.servo4_raw = us[3];
    s.servo5_raw = us[4];
    s.servo6_raw = us[5];
    s.servo7_raw = us[6];
    s.servo8_raw = us[7];
    SEND(v, servo_output_raw, s);
}

void station_say(vehicle *v, uint8_t severity, const char *text) {
    mavlink_statustext_t s = {0};
    s.severity = severity;
    size_t n = strlen(text);
    memcpy(s.text, text, n < sizeof s.text ? n : sizeof s.text);
    SEND(v, statustext, s);
}

void station_changed(vehicle *v) {
    line l = {0};
    const failsafe_out *out = &v->failsafe_out;
    add(&l, name(MODES, out->mode, 4));
    add(&l, ": ");
    add(&l, name(CAUSES, out->cause, 10));
    station_say(v, out->mode == FAILSAFE ? SEVERITY_CRITICAL : SEVERITY_NOTICE, l.text);
}

static void heartbeat(vehicle *v) {
    const failsafe_out *out = &v->failsafe_out;
    mavlink_heartbeat_t h = {0};
    h.type = vehicle_type;
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
    s.errors_count3 = capped(c->replayed + c->stale + c->leading);
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
    if (part == 2 && !v->announced && link_heard(&v->link)) {
        v->announced = true;
        say_two(v, SEVERITY_INFO, "started: ", board_cause());
    } else if (part == 2 && now / SECOND % 5 == 0) {
        work_done(v);
    }
}
