#include "pieces.h"

#include <string.h>

enum { GAP = PIECE_SLOT + PIECE_SLOT / 2 }; /* a longer one between two pieces: one is missing */

/* CRC-16 of CCITT, from 0xFFFF. */
static uint16_t check_of(const uint8_t *bytes, size_t n) {
    uint32_t crc = 0xFFFFu;
    for (size_t i = 0; i < n; ++i) {
        crc ^= (uint32_t)bytes[i] << 8;
        for (int bit = 0; bit < 8; ++bit) crc = (crc & 0x8000u) != 0u ? (crc << 1 ^ 0x1021u) & 0xFFFFu : crc << 1;
    }
    return (uint16_t)crc;
}

size_t message_pack(uint8_t id, const uint8_t *data, size_t n, uint8_t *to) {
    size_t k = 0;
    if (n > (size_t)MESSAGE_DATA || (id == MESSAGE_LIFT && n != (size_t)LIFT_DATA)) return 0;
    to[k++] = MESSAGE_HEADER;
    to[k++] = id;
    if (id != MESSAGE_LIFT) to[k++] = (uint8_t)n;
    memcpy(to + k, data, n);
    k += n;
    uint16_t check = check_of(to, k);
    to[k++] = (uint8_t)(check & 0xFFu);
    to[k++] = (uint8_t)(check >> 8);
    return k;
}

int message_unpack(const uint8_t *bytes, size_t n, bus_message *to) {
    if (n > 0u && bytes[0] != MESSAGE_HEADER) return -1;
    if (n > 1u && bytes[1] != MESSAGE_LIFT && bytes[1] != MESSAGE_PING) return -1;
    if (n < 3u) return 0;
    size_t length = LIFT_DATA, head = 2;
    if (bytes[1] != MESSAGE_LIFT) {
        length = bytes[2];
        head = 3;
    }
    size_t all = head + length + 2u;
    if (length > (size_t)MESSAGE_DATA) return -1;
    if (n < all) return 0;
    uint32_t check = (uint32_t)bytes[all - 2u] | (uint32_t)bytes[all - 1u] << 8;
    if (check != check_of(bytes, all - 2u)) return -1;
    to->id = bytes[1];
    to->n = length;
    memcpy(to->data, bytes + head, length);
    return (int)all;
}

int64_t pieces_begin(const piece_queue *q, int64_t now) {
    int64_t from = now > q->free_at ? now : q->free_at;
    return (from + PIECE_SLOT - 1) / PIECE_SLOT * PIECE_SLOT;
}

bool pieces_offer(piece_queue *q, int64_t now, uint8_t id, const uint8_t *data, size_t n) {
    uint8_t bytes[MESSAGE_MOST];
    size_t all = message_pack(id, data, n, bytes), count = (all + PIECE_BYTES - 1u) / PIECE_BYTES;
    if (all == 0u) return false;
    size_t last = all - (count - 1u) * PIECE_BYTES;
    int64_t begins = pieces_begin(q, now);
    int64_t over = begins + (int64_t)(count - 1u) * PIECE_SLOT + (int64_t)(last + 1u) * BUS_BYTE;
    if (over - now > PIECE_QUEUE || q->put - q->taken + count > (uint32_t)PIECES_WAITING) {
        ++q->dropped;
        return false;
    }
    if (q->put == q->taken) q->due = begins;
    for (size_t k = 0; k < count; ++k) {
        piece *p = &q->waiting[q->put++ % PIECES_WAITING];
        p->n = k + 1u < count ? (size_t)PIECE_BYTES : last;
        memcpy(p->bytes, bytes + k * PIECE_BYTES, p->n);
    }
    q->free_at = begins + (int64_t)count * PIECE_SLOT;
    return true;
}

/* Where slots were missed, all that waits goes as much later. */
bool pieces_next(piece_queue *q, int64_t now, piece *to) {
    if (q->put == q->taken || now < q->due) return false;
    int64_t missed = (now - q->due) / PIECE_SLOT * PIECE_SLOT;
    *to = q->waiting[q->taken++ % PIECES_WAITING];
    to->at = now + (int64_t)(to->n + 1u) * BUS_BYTE;
    q->due += missed + PIECE_SLOT;
    q->free_at += missed;
    return true;
}

static void drop(piece_assembler *a, size_t count) {
    a->n -= count;
    memmove(a->kept, a->kept + count, a->n * sizeof a->kept[0]);
}

void pieces_put(piece_assembler *a, const piece *p) {
    if (p->n == 0u || p->n > (size_t)PIECE_BYTES) return;
    if (a->n == (size_t)PIECES_KEPT) {
        ++a->broken;
        drop(a, 1);
    }
    a->kept[a->n++] = *p;
}

/* How many pieces the message has that begins with the first one kept: 0 where it isn't whole yet, -1 where it is none. */
static int count_pieces(const piece_assembler *a, bus_message *to) {
    uint8_t bytes[PIECES_KEPT * PIECE_BYTES];
    size_t n = 0;
    for (size_t k = 0; k < a->n; ++k) {
        if (k > 0u && a->kept[k].at - a->kept[k - 1u].at > GAP) return -1;
        memcpy(bytes + n, a->kept[k].bytes, a->kept[k].n);
        n += a->kept[k].n;
        int all = message_unpack(bytes, n, to);
        if (all != 0) return all == (int)n ? (int)k + 1 : -1; /* a message ends with its last piece */
    }
    return 0;
}

bool pieces_message(piece_assembler *a, bus_message *to) {
    while (a->n > 0u) {
        int count = count_pieces(a, to);
        if (count == 0) return false;
        if (count > 0) {
            to->at = a->kept[0].at - (int64_t)(a->kept[0].n + 1u) * BUS_BYTE;
            drop(a, (size_t)count);
            return true;
        }
        ++a->broken; /* look for a message that begins with the next piece */
        drop(a, 1);
    }
    return false;
}
