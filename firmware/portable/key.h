/* The key, in an image of its own that is written to the board apart from the program:

     bytes 0-7    "trimtab1"
     bytes 8-39   the key
     bytes 40-47  the day it was made, as a time stamp, low byte first: nothing signed earlier is believed
     bytes 48-51  CRC-32 of IEEE 802.3 over bytes 0-47, low byte first */
#ifndef KEY_H
#define KEY_H
#include <stdbool.h>
#include <stdint.h>

enum { KEY_BYTES = 32, KEY_IMAGE = 52 };

typedef struct {
    uint8_t secret[KEY_BYTES];
    uint64_t since;
} vehicle_key;

/* Whether there is a key at the place; NULL is none. */
bool key_read(const uint8_t *image, vehicle_key *to);
#endif
