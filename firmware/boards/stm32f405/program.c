/* The start of the program on a stack of its own, how deep that was used, and the program's end. */
#include "board.h"
#include "port.h"
#include "registers.h"

void board_reset(void) {
    register_set(SCB_AIRCR, 0x05FA0000u | BIT(2));
    for (;;) {} /* and if it does not reset, the watchdog does */
}

#ifndef REGISTER_MODEL
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
