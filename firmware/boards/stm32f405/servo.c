/* Servo pulses by timer 3: one to four outputs on C6, C7, C8, C9. RM0090 chapter 18; PWM mode 1 in 18.3.9.

   Compare registers are preloaded: a new width holds from the next frame on, and no frame is cut. */
#include "board.h"
#include "port.h"
#include "pulse.h"
#include "registers.h"

enum { PWM_1 = 6 << 4, PRELOAD = BIT(3), ARPE = BIT(7), CEN = BIT(0), FIRST_PIN = 6 };

typedef char no_more_than_four[(int)CHANNELS <= 4 ? 1 : -1];

/* Of each output's pin so many bits of a register whose fields are that wide, from the first pin on. */
static uint32_t pins(uint32_t width, uint32_t bits, int first) {
    uint32_t all = 0;
    for (int i = first; i < CHANNELS; ++i) {
        uint32_t at = width * (uint32_t)(FIRST_PIN + i);
        if (at < 32u || first > 0) all |= bits << (at % 32u);
    }
    return all;
}

void servo_begin(void) {
    uint32_t enables = 0;
    register_change(RCC_AHB1ENR, 0, BIT(2));
    register_change(RCC_APB1ENR, 0, BIT(1));
    register_set(TIM3 + TIM_PSC, APB1_TIMER_HZ / PULSE_HZ - 1u);
    register_set(TIM3 + TIM_ARR, FRAME / 5 - 1); /* of 100 ns, in counts */
    register_set(TIM3 + TIM_CCMR1, (uint32_t)(PWM_1 | PRELOAD) << 8 | PWM_1 | PRELOAD);
    register_set(TIM3 + TIM_CCMR2, (uint32_t)(PWM_1 | PRELOAD) << 8 | PWM_1 | PRELOAD);
    for (int i = 0; i < CHANNELS; ++i) servo_set(i, SAFE_PULSES[i]);
    for (int i = 0; i < CHANNELS; ++i) enables |= 1u << 4 * i;
    register_set(TIM3 + TIM_CCER, enables);
    register_set(TIM3 + TIM_EGR, 1); /* takes over prescaler and widths before the first frame */
    register_set(TIM3 + TIM_CR1, ARPE | CEN);
    register_change(GPIOC + GPIO_AFRL, pins(4, 0xF, 0), pins(4, 2, 0));
    register_change(GPIOC + GPIO_AFRL + 4u, pins(4, 0xF, 2), pins(4, 2, 2));
    register_change(GPIOC + GPIO_MODER, pins(2, 3, 0), pins(2, 2, 0)); /* last: the pins are open until the pulses are right */
}

void servo_set(int channel, uint16_t counts) {
    if (channel >= 0 && channel < CHANNELS) register_set(TIM3 + TIM_CCR1 + 4u * (uint32_t)channel, counts);
}

/* The pins are inputs again, and pulled to ground: no frame is begun. */
void servo_silence(void) {
    register_change(GPIOC + GPIO_PUPDR, pins(2, 3, 0), pins(2, 2, 0));
    register_change(GPIOC + GPIO_MODER, pins(2, 3, 0), 0);
}
