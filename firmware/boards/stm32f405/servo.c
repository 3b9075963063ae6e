/* Servo pulses by timer 3: rudder on C6, thrust on C7, lift on C8. RM0090 chapter 18; PWM mode 1 in 18.3.9.

   Compare registers are preloaded: a new width holds from the next frame on, and no frame is cut. */
#include "board.h"
#include "port.h"
#include "pulse.h"
#include "registers.h"

enum { PWM_1 = 6 << 4, PRELOAD = BIT(3), ARPE = BIT(7), CEN = BIT(0) };

void servo_begin(void) {
    register_change(RCC_AHB1ENR, 0, BIT(2));
    register_change(RCC_APB1ENR, 0, BIT(1));
    register_set(TIM3 + TIM_PSC, APB1_TIMER_HZ / PULSE_HZ - 1u);
    register_set(TIM3 + TIM_ARR, PULSE_FRAME - 1u);
    register_set(TIM3 + TIM_CCMR1, (uint32_t)(PWM_1 | PRELOAD) << 8 | PWM_1 | PRELOAD);
    register_set(TIM3 + TIM_CCMR2, PWM_1 | PRELOAD);
    for (int i = 0; i < CHANNELS; ++i) servo_set(i, i == LIFT ? PULSE_NEUTRAL - PULSE_SPAN : PULSE_NEUTRAL);
    register_set(TIM3 + TIM_CCER, BIT(0) | BIT(4) | BIT(8));
    register_set(TIM3 + TIM_EGR, 1); /* takes over prescaler and widths before the first frame */
    register_set(TIM3 + TIM_CR1, ARPE | CEN);
    register_change(GPIOC + GPIO_AFRL, 0xFF000000u, 0x22000000u);
    register_change(GPIOC + GPIO_AFRL + 4u, 0xFu, 0x2u);
    register_change(GPIOC + GPIO_MODER, 0x3F000u, 0x2A000u); /* last: the pins are open until the pulses are right */
}

void servo_set(int channel, uint16_t counts) {
    if (channel >= 0 && channel < CHANNELS) register_set(TIM3 + TIM_CCR1 + 4u * (uint32_t)channel, counts);
}

/* The pins are inputs again, and pulled to ground: no frame is begun. */
void servo_silence(void) {
    register_change(GPIOC + GPIO_PUPDR, 0x3F000u, 0x2A000u);
    register_change(GPIOC + GPIO_MODER, 0x3F000u, 0);
}
