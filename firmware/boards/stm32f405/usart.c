/* USART 1 by DMA at BAUD: A9 sends, A10 receives. RM0090 chapters 30 (USART) and 10 (DMA).

   The receiver's DMA goes round its buffer for ever and the reader follows; the transmitter's takes one unbroken
   piece of its buffer after the other. */
#include "board.h"
#include "registers.h"

enum { RX_SIZE = 4096, TX_SIZE = 8192 };
enum { UE = BIT(13), IDLEIE = BIT(4), TE = BIT(3), RE = BIT(2), DMAT = BIT(7), DMAR = BIT(6) };
enum { CHANNEL_4 = 4 << 25, MINC = BIT(10), CIRC = BIT(8), TO_PERIPHERAL = BIT(6), TCIE = BIT(4), EN = BIT(0) };
enum { RX_TC = BIT(21), TX_TC = BIT(27), TX_ALL = 0x3D << 22, RX_ALL = 0x3D << 16 };

static uint8_t rx[RX_SIZE], tx[TX_SIZE];
static volatile uint32_t laps;              /* of the receiver's DMA */
static uint32_t taken, lost;                /* bytes ever taken; overwritten before they were */
static volatile uint32_t put, sent, flying; /* bytes ever put and sent; on their way just now */

void usart_begin(void) {
    laps = taken = lost = put = sent = flying = 0;
    register_change(RCC_AHB1ENR, 0, BIT(0) | BIT(22)); /* port A, DMA 2 */
    register_change(RCC_APB2ENR, 0, BIT(4));
    register_change(GPIOA + GPIO_AFRL + 4u, 0xFF0u, 0x770u);
    register_change(GPIOA + GPIO_PUPDR, 3u << 20, 1u << 20); /* an open line is idle */
    register_change(GPIOA + GPIO_MODER, 15u << 18, 10u << 18);
    register_set(USART_BRR, (APB2_HZ + BAUD / 2) / BAUD);
    register_set(USART_CR3, DMAT | DMAR);
    register_set(USART_CR1, UE | IDLEIE | TE | RE);
    register_set(DMA_RX + DMA_PAR, USART_DR);
    register_set(DMA_RX + DMA_M0AR, (uint32_t)(uintptr_t)rx);
    register_set(DMA_RX + DMA_NDTR, RX_SIZE);
    register_set(DMA_LIFCR, RX_ALL);
    register_set(DMA_RX + DMA_CR, CHANNEL_4 | MINC | CIRC | TCIE | EN);
    register_set(DMA_TX + DMA_PAR, USART_DR);
    register_set(NVIC_ISER1, BIT(IRQ_USART1 - 32) | BIT(IRQ_DMA2_STREAM2 - 32));
    register_set(NVIC_ISER1 + 4u, BIT(IRQ_DMA2_STREAM7 - 64));
}

/* The line fell idle: only wakes the processor. Reading state, then data, clears it; no byte is there for us to take. */
void usart_interrupt(void) {
    (void)register_get(USART_SR);
    (void)register_get(USART_DR);
}

static void count_lap(void) {
    if (register_get(DMA_LISR) & RX_TC) {
        register_set(DMA_LIFCR, RX_TC);
        ++laps;
    }
}

void usart_lapped(void) { count_lap(); }

/* Bytes ever received. The lap may end between two looks: the count is taken again until both looks agree. */
static uint32_t received(void) {
    uint32_t before = mask_interrupts(), left, again;
    do {
        left = register_get(DMA_RX + DMA_NDTR);
        count_lap();
        again = register_get(DMA_RX + DMA_NDTR);
    } while (again > left);
    uint32_t all = laps * RX_SIZE + (RX_SIZE - left);
    restore_interrupts(before);
    return all;
}

bool usart_read(uint8_t *byte) {
    uint32_t unread = received() - taken;
    if (unread == 0u) return false;
    if (unread > RX_SIZE) {
        lost += unread - RX_SIZE / 2u;
        taken += unread - RX_SIZE / 2u; /* the older half may be overwritten while it is read */
    }
    *byte = rx[taken++ % RX_SIZE];
    return true;
}

bool usart_waiting(void) { return received() != taken; }

uint32_t usart_lost(void) { return lost; }

/* Start the next piece; interrupts are masked, or this is the handler. */
static void fly(void) {
    uint32_t at = sent % TX_SIZE, n = put - sent;
    if (flying != 0u || n == 0u) return;
    if (n > TX_SIZE - at) n = TX_SIZE - at;
    flying = n;
    register_set(DMA_HIFCR, TX_ALL);
    register_set(DMA_TX + DMA_M0AR, (uint32_t)(uintptr_t)(tx + at));
    register_set(DMA_TX + DMA_NDTR, n);
    register_set(DMA_TX + DMA_CR, CHANNEL_4 | MINC | TO_PERIPHERAL | TCIE | EN);
}

void usart_sent(void) {
    if (!(register_get(DMA_HISR) & TX_TC)) return;
    register_set(DMA_HIFCR, TX_ALL);
    sent += flying;
    flying = 0;
    fly();
}

bool usart_write(const uint8_t *bytes, size_t n) {
    if (n > TX_SIZE - (put - sent)) return false;
    for (size_t i = 0; i < n; ++i) tx[(put + i) % TX_SIZE] = bytes[i];
    uint32_t before = mask_interrupts();
    put += (uint32_t)n;
    fly();
    restore_interrupts(before);
    return true;
}
