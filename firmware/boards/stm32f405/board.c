/* The functions of port.h that need no driver of their own, and the start of the program.

   Time is timer 2, at 2 MHz; the processor's own timer ticks a thousand times a second. */
#include "board.h"
#include "port.h"
#include "registers.h"

enum { COUNT_HZ = 2000000 };

static uint32_t last;   /* count of timer 2 */
static int64_t counted; /* since the start, up to `last` */
static volatile bool ticked;
static bool crystal; /* whether it drives the clock */
static const char *cause, *refusal;

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
static void time_begin(void) {
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

void board_ticked(void) {
    encoder_catch(board_now());
    receiver_tick();
    ticked = true;
}

bool board_write(const uint8_t *bytes, size_t n) { return usart_write(bytes, n); }
bool board_read(uint8_t *byte) { return usart_read(byte); }
uint32_t board_lost(void) { return usart_lost(); }
bool board_radio(uint16_t us[RADIO_CHANNELS]) { return receiver_read(us); }

void board_reset(void) {
    register_set(SCB_AIRCR, 0x05FA0000u | BIT(2));
    for (;;) {} /* and if it does not reset, the watchdog does */
}

/* Servos first, so that they hear neutral pulses as soon as may be; then the watchdog, and what may take long. */
void board_begin(bool by_crystal) {
    crystal = by_crystal;
    cause = reset_cause();
    servo_begin();
    watchdog_begin();
    brown_out_begin();
    time_begin();
    receiver_begin();
    encoder_begin();
    usart_begin();
    storage_begin();
}

const char *board_cause(void) { return cause; }

void board_refuse(const char *reason) { refusal = reason; }

const char *board_refusal(void) {
    if (!crystal) return "no crystal";
    if (storage_failures() != 0u) return "storage";
    return refusal;
}

#ifndef REGISTER_MODEL
/* With interrupts masked, one that comes after the look still wakes the processor. */
void board_wait(void) {
    uint32_t before = mask_interrupts();
    if (!usart_waiting() && !ticked) __asm volatile("dsb\n wfi" ::: "memory");
    ticked = false;
    restore_interrupts(before);
}

static const uint32_t PAINT = 0xA5C35A3Cu;
extern uint32_t stack_bottom[], stack_top[];

uint32_t board_stack(void) {
    const uint32_t *at = stack_bottom;
    while (at < stack_top && *at == PAINT) ++at;
    return (uint32_t)(stack_top - at) * 4u;
}

/* The program on a stack of its own at the bottom of RAM; interrupts use the other one. */
void run(void);

__attribute__((naked)) int main(void) {
    __asm volatile(" ldr r0, =stack_top\n msr psp, r0\n movs r0, #2\n msr control, r0\n isb\n"
                   " ldr r0, =started\n bx r0\n .ltorg");
}

__attribute__((used, noreturn)) void started(void) {
    uint32_t *here = (uint32_t *)__builtin_frame_address(0) - 16;
    for (volatile uint32_t *at = stack_bottom; at < here; ++at) *at = PAINT;
    board_begin(clock_begin());
    for (;;) run();
}
#endif
