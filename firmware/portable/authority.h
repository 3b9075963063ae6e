/* Who commands: whoever armed, until nobody does, or hands over when asked to. As trimtab.flight.mavlink.authority has it. */
#ifndef AUTHORITY_H
#define AUTHORITY_H
#include <stdbool.h>
#include <stdint.h>

/* session: a number that a program draws when it starts; 0: it tells none, as ground stations do.
 * link: number of its signature's stream: a program that reads a session on the line cannot use it on another stream. */
typedef struct {
    uint8_t system, component, link;
    uint32_t session;
} sender;

typedef struct {
    sender owner;
    bool owned;       /* there is an owner; armed and not owned: it belongs to the autopilot whose command comes first */
    uint8_t system;   /* the vehicle's: only an autopilot of this system takes a vehicle that a ground station has armed */
    bool armed;
    uint32_t foreign; /* commands refused so far, of others */
} authority;

/* A session from the parameter of a command; 0 where it is none. */
uint32_t authority_session(float parameter);

/* Whether a sender may arm or disarm: another autopilot may not; who has no session is a person's hand. */
bool authority_allows(const authority *a, const sender *s);

void authority_arm(authority *a, const sender *s);
void authority_hand_over(authority *a, const sender *s);

/* Whether a sender's command is obeyed. */
bool authority_admits(authority *a, const sender *s);

/* Nobody commands any more. */
void authority_end(authority *a);
#endif
