/* Interrupts of the boards mps2-an386 and mps2-an500: numbers 0 and 1 are those of UART 0. */
#ifndef INTERRUPTS_H
#define INTERRUPTS_H

void board_ticked(void);
void board_expired(void);
void board_received(void);
void board_sent(void);

#define TICK board_ticked
#define NMI board_expired
#define INTERRUPTS (void *)board_received, (void *)board_sent
#define PERIPHERALS_SIZE 0x10000
#endif
