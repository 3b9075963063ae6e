/* What exported text calls of the C library, defined in library.c. */
#ifndef TRIMTAB_STRING_H
#define TRIMTAB_STRING_H

#include <stddef.h>

void *memcpy(void *restrict to, const void *restrict from, size_t count);
void *memset(void *to, int value, size_t count);

#endif
