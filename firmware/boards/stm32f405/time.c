/* Time is timer 2, at 2 MHz; the processor's own timer ticks a thousand times a second. */
#include "board.h"
#include "port.h"
#include "registers.h"

enum { COUNT_HZ = 2000000 };

static uint32_t last;   /* count of timer 2 */
static int64_t counted; /* since the start, up to `last` */

uint32_t mask_interrupts(void) {
    uint32_t before = 0;
#ifndef REGISTER_MODEL
    __asm volatile("mrs %0, primask\n cpsid i" : "=r"(before)::"memory");
#endif
    return before;
}

void restore_interrupts(uint32_t before) {
    (void)before;
#ifndef REGISTER_MODEL
    __asm volatile("msr primask, %0" ::"r"(before) : "memory");
#endif
}

/* Timer 2 goes on while an erasure of flash holds the processor up. It runs over after 35 minutes. */
void time_begin(void) {
    register_change(RCC_APB1ENR, 0, BIT(0));
    register_set(TIM2 + TIM_PSC, APB1_TIMER_HZ / COUNT_HZ - 1u);
    register_set(TIM2 + TIM_ARR, 0xFFFFFFFFu);
    register_set(TIM2 + TIM_EGR, 1);
    register_set(TIM2 + TIM_CR1, 1);
    last = register_get(TIM2 + TIM_CNT);
    register_set(SYSTICK_LOAD, CORE_HZ / 1000 - 1u);
    register_set(SYSTICK_VAL, 0);
    register_set(SYSTICK_CTRL, 7);
}

int64_t board_now(void) {
    uint32_t before = mask_interrupts(), now = register_get(TIM2 + TIM_CNT);
    counted += (uint32_t)(now - last);
    last = now;
    int64_t counts = counted;
    restore_interrupts(before);
    return counts * (10000000 / COUNT_HZ);
}
