/* The thrust fan's encoder: timer 4 counts the edges of B6 and B7 by itself (RM0090 18.3.12), and each millisecond its
   count is kept, for the regulator asks for counts of its own ticks, after them. */
#include "board.h"
#include "registers.h"

enum { KEPT = 256, MS = 10000 };

static volatile uint16_t kept[KEPT];
static volatile int64_t last;

void encoder_begin(void) {
    register_change(RCC_AHB1ENR, 0, BIT(1));
    register_change(RCC_APB1ENR, 0, BIT(2));
    register_change(GPIOB + GPIO_AFRL, 0xFF000000u, 0x22000000u);
    register_change(GPIOB + GPIO_PUPDR, 0xF000u, 0x5000u); /* open collectors */
    register_change(GPIOB + GPIO_MODER, 0xF000u, 0xA000u);
    register_set(TIM4 + TIM_ARR, 0xFFFFu);
    register_set(TIM4 + TIM_CCMR1, 0x3131u);
    register_set(TIM4 + TIM_SMCR, 3u); /* both edges of both: four counts a line */
    register_set(TIM4 + TIM_CR1, 1u);
}

void encoder_catch(int64_t now) {
    last = now / MS;
    kept[last % KEPT] = (uint16_t)register_get(TIM4 + TIM_CNT);
}

/* As it was at the last millisecond not after `at`; from before the oldest that is kept, the oldest. */
uint16_t encoder_count(int64_t at) {
    int64_t ms = at / MS, newest = last;
    if (ms > newest) ms = newest;
    if (ms <= newest - KEPT) ms = newest - KEPT + 1;
    if (ms < 0) ms = 0;
    return kept[ms % KEPT];
}
