/* C library functions that exported text calls. They are defined in library.c. */
#ifndef TRIMTAB_STRING_H
#define TRIMTAB_STRING_H

#include <stddef.h>

void *memcpy(void *restrict to, const void *restrict from, size_t count);
void *memset(void *to, int value, size_t count);

#endif
