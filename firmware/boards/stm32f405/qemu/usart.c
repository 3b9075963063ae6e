/* In the place of usart.c in the emulator, which has USART 1 but no DMA: a byte, an interrupt. */
#include "board.h"
#include "registers.h"
#include "ring.h"

enum { RXNE = BIT(5), UE = BIT(13), RXNEIE = BIT(5), TE = BIT(3), RE = BIT(2) };

static ring in;
static volatile uint32_t lost;

void usart_begin(void) {
    register_set(USART_CR1, UE | RXNEIE | TE | RE);
    register_set(NVIC_ISER1, BIT(IRQ_USART1 - 32));
}

void usart_interrupt(void) {
    while (register_get(USART_SR) & RXNE) {
        uint8_t byte = (uint8_t)register_get(USART_DR);
        if (!ring_put(&in, &byte, 1)) ++lost;
    }
}

void usart_lapped(void) {}
void usart_sent(void) {}
bool usart_waiting(void) { return ring_used(&in) != 0u; }
bool usart_read(uint8_t *byte) { return ring_take(&in, byte); }
uint32_t usart_lost(void) { return lost; }

/* The emulator sends a byte in the instruction that writes it. */
bool usart_write(const uint8_t *bytes, size_t n) {
    for (size_t i = 0; i < n; ++i) register_set(USART_DR, bytes[i]);
    return true;
}
