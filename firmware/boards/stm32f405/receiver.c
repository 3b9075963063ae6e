/* The safety pilot's receiver: three pulses on A0 to A2 (rudder, thrust, mode), caught by timer 5 at a microsecond.
   RM0090 18.3.5: a channel that captures at both edges; which edge it was, the pin tells.

   A pulse of 0.8 to 2.2 ms counts, and for 100 ms; all three must be there, for a receiver out of range stops them. */
#include "board.h"
#include "port.h"
#include "registers.h"

enum { SHORTEST = 800, LONGEST = 2200, GOOD_FOR = 100 }; /* us, us, ms */

static uint32_t rose[RADIO_CHANNELS];
static volatile uint16_t width[RADIO_CHANNELS];
static volatile uint16_t age[RADIO_CHANNELS]; /* ms since the last good pulse; stands at GOOD_FOR */

void receiver_begin(void) {
    for (int i = 0; i < RADIO_CHANNELS; ++i) age[i] = GOOD_FOR;
    register_change(RCC_AHB1ENR, 0, BIT(0));
    register_change(RCC_APB1ENR, 0, BIT(3));
    register_change(GPIOA + GPIO_AFRL, 0xFFFu, 0x222u);
    register_change(GPIOA + GPIO_PUPDR, 0x3Fu, 0x2Au);
    register_change(GPIOA + GPIO_MODER, 0x3Fu, 0x2Au);
    register_set(TIM5 + TIM_PSC, APB1_TIMER_HZ / 1000000 - 1u);
    register_set(TIM5 + TIM_ARR, 0xFFFFFFFFu);
    register_set(TIM5 + TIM_CCMR1, 0x3131u); /* input, eight equal samples before an edge counts */
    register_set(TIM5 + TIM_CCMR2, 0x31u);
    register_set(TIM5 + TIM_CCER, 0xBBBu); /* on, both edges */
    register_set(TIM5 + TIM_DIER, 7u << 1);
    register_set(TIM5 + TIM_EGR, 1);
    register_set(TIM5 + TIM_CR1, 1);
    register_set(NVIC_ISER1, BIT(IRQ_TIM5 - 32));
}

void receiver_captured(void) {
    uint32_t flags = register_get(TIM5 + TIM_SR), pins = register_get(GPIOA + GPIO_IDR);
    for (uint32_t i = 0; i < (uint32_t)RADIO_CHANNELS; ++i) {
        if (!(flags & BIT(1u + i))) continue;
        uint32_t at = register_get(TIM5 + TIM_CCR1 + 4u * i); /* clears the flag */
        uint32_t long_ = at - rose[i];
        if (pins & BIT(i)) {
            rose[i] = at;
        } else if (long_ >= SHORTEST && long_ <= LONGEST) {
            width[i] = (uint16_t)long_;
            age[i] = 0;
        }
    }
}

void receiver_tick(void) {
    for (int i = 0; i < RADIO_CHANNELS; ++i)
        if (age[i] < GOOD_FOR) age[i]++;
}

bool receiver_read(uint16_t us[]) {
    bool heard = true;
    for (int i = 0; i < RADIO_CHANNELS; ++i) {
        us[i] = width[i];
        heard = heard && age[i] < GOOD_FOR;
    }
    return heard;
}
