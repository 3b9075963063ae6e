/* Records in two sectors of flash, one in use and one erased: a cut of power at any write loses at most the record that
   was being written.

   A sector begins with a mark that its erasure was finished, the sector's number in the order of use, and a checksum, which
   is written last: it commits. A record is a tag, the payload and a checksum over both and the sector's number. Where
   the sector in use is full, the latest record of each tag that is copied goes to the other one, which is then committed. */
#ifndef JOURNAL_H
#define JOURNAL_H
#include <stdbool.h>
#include <stdint.h>

enum { JOURNAL_WORDS = 8 }; /* most of a payload */

typedef struct {
    uint32_t sector[2]; /* where they begin */
    uint32_t size;      /* bytes of each */
    uint32_t words;     /* of a record's payload */
    uint32_t copied;    /* tags below this one outlive their sector */
    int active;         /* which is in use; -1: none */
    uint32_t number;    /* of the sector in use */
    uint32_t next;      /* address of the next record */
    bool spare;         /* the other one is erased */
    uint32_t failures;  /* records that could not be written */
} journal;

/* Find what is there. Nothing is written: what a cut of power left half done waits for journal_tidy. */
void journal_open(journal *j);

/* Add a record; where there is no room and no erased sector to go on in, it is not written, and counted. Microseconds. */
bool journal_append(journal *j, uint32_t tag, const uint32_t *payload);

/* The newest record of a tag; whether there is one. */
bool journal_find(const journal *j, uint32_t tag, uint32_t *payload);

/* Erase what may be erased: slow, only while nothing moves. A journal more than half full is moved first if its tags are
   copied; one whose records are not copied loses the older sector. */
void journal_tidy(journal *j);

/* Records in a sector, oldest first; for who reads them out. */
uint32_t journal_capacity(const journal *j);
#endif
