#include "tuning.h"

#include <string.h>

enum { REAL32 = 9, ALL = -1 };

enum { COUNT = DRIVE_PARAMETERS, NAME = 16 };

/* No NaN is. */
static bool is_allowed(int k, float value) {
    return value >= drive_parameters[k].low && value <= drive_parameters[k].high;
}

void tuning_begin(vehicle *v) {
    v->listed = COUNT;
    for (int k = 0; k < COUNT; ++k) {
        float value;
        if (board_load(k, &value) && is_allowed(k, value)) drive_set_parameter(&v->drive, k, value);
    }
}

static void send_value(vehicle *v, int k) {
    mavlink_message_t message;
    mavlink_param_value_t p = {0};
    p.param_value = drive_parameter(&v->drive, k);
    p.param_count = COUNT;
    p.param_index = (uint16_t)k;
    p.param_type = REAL32;
    memcpy(p.param_id, drive_parameters[k].name, strlen(drive_parameters[k].name));
    mavlink_msg_param_value_encode_status(SYSTEM, COMPONENT, &v->link.status, &message, &p);
    link_send(&v->link, &message);
}

static int find(const char name[NAME]) {
    for (int k = 0; k < COUNT; ++k)
        if (strncmp(name, drive_parameters[k].name, NAME) == 0) return k;
    return COUNT;
}

static bool is_for_us(uint8_t system, uint8_t component) {
    return (system == 0 || system == SYSTEM) && (component == 0 || component == COMPONENT);
}

/* What is refused is answered with the value that holds. */
static void set(vehicle *v, const mavlink_param_set_t *p) {
    int k = find(p->param_id);
    if (k == COUNT) return;
    if (v->failsafe_out.armed || p->param_type != REAL32 || !is_allowed(k, p->param_value)) {
        station_say(v, 4, v->failsafe_out.armed ? "parameter refused: armed" : "parameter refused: out of bounds");
    } else {
        drive_set_parameter(&v->drive, k, p->param_value);
        board_store(k, p->param_value);
    }
    send_value(v, k);
}

static void read_one(vehicle *v, const mavlink_param_request_read_t *p) {
    int k = p->param_index == ALL ? find(p->param_id) : p->param_index;
    if (k >= 0 && k < COUNT) send_value(v, k);
}

bool tuning_hear(vehicle *v, const mavlink_message_t *message) {
    mavlink_param_request_list_t list;
    mavlink_param_request_read_t one;
    mavlink_param_set_t change;
    switch (message->msgid) {
    case MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
        mavlink_msg_param_request_list_decode(message, &list);
        if (is_for_us(list.target_system, list.target_component)) v->listed = 0;
        return true;
    case MAVLINK_MSG_ID_PARAM_REQUEST_READ:
        mavlink_msg_param_request_read_decode(message, &one);
        if (is_for_us(one.target_system, one.target_component)) read_one(v, &one);
        return true;
    case MAVLINK_MSG_ID_PARAM_SET:
        mavlink_msg_param_set_decode(message, &change);
        if (is_for_us(change.target_system, change.target_component)) set(v, &change);
        return true;
    default: return false;
    }
}

void tuning_work(vehicle *v) {
    if (v->listed < COUNT) send_value(v, v->listed++);
}
