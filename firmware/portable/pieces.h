/* A slow bus between two controllers of a vehicle: messages in pieces, one each slot, in order.

   A message is a header, an id, for some ids a length, data, and a check; it begins with a piece of its own. Times are in
   units of 100 ns. As `SlaveBus` of the scenarios has it. Source: Z. Kulis, "Feedback control of a hovercraft over a
   wireless link", University of Maryland, 2006, chapter 5: header, id, optional length, data; at most 10 bytes each
   10 ms. The header's value, the ids, the check and the longest time on the way are reconstructed. */
#ifndef PIECES_H
#define PIECES_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { PIECE_BYTES = 10, PIECE_SLOT = 100000, PIECE_QUEUE = 2000000 };
enum { BUS_BIT = 100, BUS_BYTE = 9 * BUS_BIT }; /* 100 kHz; eight bits and an acknowledgement */
enum { MESSAGE_HEADER = 0xA5, MESSAGE_PING = 2, MESSAGE_LIFT = 5 };
enum { MESSAGE_DATA = 40, MESSAGE_MOST = MESSAGE_DATA + 5, LIFT_DATA = 2 };
enum { PIECES_WAITING = 32, PIECES_KEPT = 8 };

typedef struct {
    size_t n;
    int64_t at; /* when its last byte was over */
    uint8_t bytes[PIECE_BYTES];
} piece;

typedef struct {
    piece waiting[PIECES_WAITING];
    uint32_t put, taken;
    int64_t due;      /* when the first of them goes */
    int64_t free_at;  /* the first slot that nobody was promised */
    uint32_t dropped; /* messages that would have been on their way for too long */
} piece_queue;

typedef struct {
    uint8_t id;
    size_t n;
    uint8_t data[MESSAGE_DATA];
    int64_t at; /* when its first piece began */
} bus_message;

typedef struct {
    piece kept[PIECES_KEPT];
    size_t n;
    uint32_t broken; /* pieces that belong to no message */
} piece_assembler;

/* Write a message to `to`, which has room for MESSAGE_MOST; its length, 0 where the data are too long or of the wrong
   length for this id. */
size_t message_pack(uint8_t id, const uint8_t *data, size_t n, uint8_t *to);

/* The message that these bytes begin with: how many bytes it has, 0 where more are needed to know, -1 where none begins
   so or its check is wrong. */
int message_unpack(const uint8_t *bytes, size_t n, bus_message *to);

/* When the first piece of a message offered now will go. */
int64_t pieces_begin(const piece_queue *q, int64_t now);

/* Queue a message; false where it would be on its way for too long, which is counted, or is none. */
bool pieces_offer(piece_queue *q, int64_t now, uint8_t id, const uint8_t *data, size_t n);

/* The piece whose slot it is now; false where there is none. */
bool pieces_next(piece_queue *q, int64_t now, piece *to);

/* Keep a piece that has come; then call pieces_message until it gives false. */
void pieces_put(piece_assembler *a, const piece *p);
bool pieces_message(piece_assembler *a, bus_message *to);
#endif
