/* Bytes between an interrupt and the main loop: one writes, the other reads, neither waits. */
#ifndef RING_H
#define RING_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { RING_SIZE = 16384 }; /* a power of two */

typedef struct {
    uint32_t head; /* bytes ever put; only the writer changes it */
    uint32_t tail; /* bytes ever taken; only the reader changes it */
    uint8_t bytes[RING_SIZE];
} ring;

static inline size_t ring_used(const ring *r) {
    return __atomic_load_n(&r->head, __ATOMIC_ACQUIRE) - __atomic_load_n(&r->tail, __ATOMIC_ACQUIRE);
}

/* Put n bytes, or none of them; whether there was room. */
static inline bool ring_put(ring *r, const uint8_t *bytes, size_t n) {
    uint32_t head = r->head;
    if (n > RING_SIZE - ring_used(r)) return false;
    for (size_t i = 0; i < n; ++i) r->bytes[(head + i) % RING_SIZE] = bytes[i];
    __atomic_store_n(&r->head, head + (uint32_t)n, __ATOMIC_RELEASE);
    return true;
}

/* Take one byte; false where there is none. */
static inline bool ring_take(ring *r, uint8_t *byte) {
    uint32_t tail = r->tail;
    if (!ring_used(r)) return false;
    *byte = r->bytes[tail % RING_SIZE];
    __atomic_store_n(&r->tail, tail + 1, __ATOMIC_RELEASE);
    return true;
}
#endif
