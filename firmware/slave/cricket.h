/* Lines that a Cricket prints on its serial line, one for each reply: `VR=2.0,ID=01:dc:8b,SP=MIT-6,DB=182,DR=5123,…`.

   SP is the beacon's name, of which the number at its end counts; DR the time of flight in us. Source: Cricket v2 user
   manual, MIT, 2005 (serial interface). What the thesis's own program printed is not known. */
#ifndef CRICKET_H
#define CRICKET_H
#include <stdbool.h>
#include <stdint.h>

#include "ping.h"

enum { CRICKET_LINE = 160 }; /* a longer one is no line of a Cricket */

typedef struct {
    char key[2];
    uint8_t key_n;
    uint8_t length;
    bool in_value, digits, overflows, mixed; /* digits: the value ends with some; mixed: it began otherwise */
    uint32_t number;                  /* that they make */
    bool has_beacon, has_flight;
    ping_reply reply;
} cricket;

/* Take a byte; whether it ends a line that tells of a reply. */
bool cricket_take(cricket *c, uint8_t byte, ping_reply *to);
#endif
