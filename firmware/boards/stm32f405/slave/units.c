/* The ultrasonic units' lines, 115 200 baud: USART 2 on A2 (out) and A3, USART 3 on C10 (out) and C11. RM0090 chapter 30. */
#include "board.h"
#include "ping.h"
#include "registers.h"
#include "ring.h"
#include "slave_port.h"

enum { UE = BIT(13), TXEIE = BIT(7), RXNEIE = BIT(5), TE = BIT(3), RE = BIT(2), RXNE = BIT(5), TXE = BIT(7), ORE = BIT(3) };
enum { APB1_HZ = 42000000, UNIT_BAUD = 115200 };

static const uint32_t BASE[PING_UNITS] = {USART2, USART3};
static ring in[PING_UNITS], out[PING_UNITS];

void units_begin(void) {
    register_change(RCC_AHB1ENR, 0, BIT(0) | BIT(2));
    register_change(RCC_APB1ENR, 0, BIT(17) | BIT(18));
    register_change(GPIOA + GPIO_AFRL, 0xFF00u, 0x7700u);
    register_change(GPIOA + GPIO_PUPDR, 3u << 6, 1u << 6); /* an open line is idle */
    register_change(GPIOA + GPIO_MODER, 0xF0u, 0xA0u);
    register_change(GPIOC + GPIO_AFRL + 4u, 0xFF00u, 0x7700u);
    register_change(GPIOC + GPIO_PUPDR, 3u << 22, 1u << 22);
    register_change(GPIOC + GPIO_MODER, 15u << 20, 10u << 20);
    for (int i = 0; i < PING_UNITS; ++i) {
        register_set(BASE[i] + UART_BRR, (APB1_HZ + UNIT_BAUD / 2) / UNIT_BAUD);
        register_set(BASE[i] + UART_CR1, UE | RXNEIE | TE | RE);
    }
    register_set(NVIC_ISER1, BIT(IRQ_USART2 - 32) | BIT(IRQ_USART3 - 32));
}

/* Reading state, then data, clears an overrun, too: the lost byte spoils its line, and no other. */
static void serve(int unit) {
    uint32_t status = register_get(BASE[unit] + UART_SR);
    if ((status & (RXNE | ORE)) != 0u) {
        uint8_t byte = (uint8_t)register_get(BASE[unit] + UART_DR);
        (void)ring_put(&in[unit], &byte, 1);
    }
    if ((status & TXE) != 0u) {
        uint8_t byte;
        if (ring_take(&out[unit], &byte)) register_set(BASE[unit] + UART_DR, byte);
        else register_change(BASE[unit] + UART_CR1, TXEIE, 0);
    }
}

void unit_interrupt_0(void) { serve(0); }
void unit_interrupt_1(void) { serve(1); }

bool slave_unit_read(int unit, uint8_t *byte) { return ring_take(&in[unit], byte); }

bool slave_unit_write(int unit, const uint8_t *bytes, size_t n) {
    if (!ring_put(&out[unit], bytes, n)) return false;
    uint32_t before = mask_interrupts();
    register_change(BASE[unit] + UART_CR1, 0, TXEIE);
    restore_interrupts(before);
    return true;
}

bool units_waiting(void) { return ring_used(&in[0]) != 0u || ring_used(&in[1]) != 0u; }
