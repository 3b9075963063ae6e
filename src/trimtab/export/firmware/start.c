/* Vector table, reset and faults. The table has no interrupts: none is enabled. */
#include <stdint.h>

#include "board.h"

extern uint32_t data_start[], data_end[], bss_start[], bss_end[], main_stack_top[];
extern const uint32_t data_load[];

int main(void);
void reset(void);
void fault(void);

__attribute__((section(".vectors"), used)) static void *const vectors[16] = {
    main_stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault, (void *)fault, 0,
    0,              0,             0,             (void *)fault, (void *)fault, 0,             (void *)fault, (void *)fault,
};

void reset(void) {
    *(volatile uint32_t *)0xE000ED88 = 0xFu << 20; /* CPACR: full access to the FPU */
    __asm volatile("dsb\n isb" ::: "memory");
    for (volatile uint32_t *to = data_start, *end = data_end; to < end; ++to) *to = data_load[to - data_start];
    for (volatile uint32_t *to = bss_start, *end = bss_end; to < end; ++to) *to = 0;
    leave(main());
}

void fault(void) {
    say("fault\n");
    leave(1);
}
