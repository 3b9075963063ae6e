/* The chip's own flash, by words and sectors; addresses are those it is read at. The journal is written on this. */
#ifndef FLASH_H
#define FLASH_H
#include <stdbool.h>
#include <stdint.h>

uint32_t flash_word(uint32_t address);

/* Clear bits of a word; whether it now reads as it should. 16 us, the processor standing still. */
bool flash_program(uint32_t address, uint32_t value);

/* Set all bits of the sector that begins at the address. 16 kB take 0.25 to 0.5 s, 128 kB 1 to 2 s, the processor standing
   still: only while nothing moves. */
bool flash_erase(uint32_t address);
#endif
