/* Frames of MAVLink 2 in a stream of bytes. What does not begin a frame is skipped byte by byte, and what looked like
   one and was none is searched again from its second byte on, so garbage never takes a frame with it. */
#ifndef FRAME_H
#define FRAME_H
#include <stddef.h>
#include <stdint.h>

enum { FRAME_HEADER = 10, FRAME_SIGNATURE = 13, FRAME_MAX = FRAME_HEADER + 255 + 2 + FRAME_SIGNATURE };

typedef struct {
    uint8_t bytes[FRAME_MAX];
    uint16_t n;
    uint32_t skipped; /* bytes that were in no frame */
    uint32_t broken;  /* frames with a wrong checksum: bit errors, or another dialect */
} framer;

/* Take a byte. There is always room once frame_ready has given 0. */
void frame_put(framer *f, uint8_t byte);

/* Length of the complete frame, checksum good, that f->bytes begins with; 0 while there is none. */
size_t frame_ready(framer *f);

/* Drop n bytes from the start. */
void frame_drop(framer *f, size_t n);
#endif
