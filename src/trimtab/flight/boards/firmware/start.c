/* Vector table, reset and faults. Without WITH_INTERRUPTS the table has none, and none is enabled; with it,
   interrupts.h defines TICK, the handler of the processor's timer, NMI, that of what can't be masked, INTERRUPTS, a list
   of the board's own from number 0 on, and PERIPHERALS_SIZE, how much may be touched from the timer's page on. */
#include <stdint.h>

#include "board.h"
#ifdef WITH_INTERRUPTS
#include "interrupts.h"
#else
#define TICK fault
#define NMI fault
#define INTERRUPTS
#define PERIPHERALS_SIZE 0x1000
#endif

extern uint32_t data_start[], data_end[], bss_start[], bss_end[], main_stack_top[];
extern const uint32_t data_load[];

int main(void);
void reset(void);
void fault(void);
void faulted(void);

__attribute__((section(".vectors"), used)) static void *const vectors[] = {
    main_stack_top, (void *)reset, (void *)NMI, (void *)fault, (void *)fault, (void *)fault, (void *)fault, 0,
    0,              0,             0,             (void *)fault, (void *)fault, 0,             (void *)fault, (void *)TICK,
    INTERRUPTS
};

/* The board answers 0 where it has no memory, and its flash can be written; the processor's memory protection refuses
   both. Region i has a size that is a power of two. */
static void allow(uint32_t i, uint32_t origin, uint32_t size, uint32_t how) {
    static volatile uint32_t *const mpu = (volatile uint32_t *)0xE000ED90;
    mpu[3] = origin | 1u << 4 | i;                                    /* RBAR: address and number */
    mpu[4] = how | ((uint32_t)__builtin_ctz(size) - 1) << 1 | 1u;     /* RASR: rights, size, enable */
    mpu[1] = 1;                                                       /* CTRL: nothing else is allowed */
}

static void protect(void) {
    enum { NORMAL = 1 << 19, READ_WRITE = 3 << 24, READ_ONLY = 6 << 24, NEVER_RUN = 1 << 28 };
    __asm volatile("dmb" ::: "memory");
    allow(0, FLASH_ORIGIN, FLASH_SIZE, NORMAL | READ_ONLY);
    allow(1, RAM_ORIGIN, RAM_SIZE, NORMAL | READ_WRITE | NEVER_RUN);
    allow(2, TIMER_VALUE & ~0xFFFu, PERIPHERALS_SIZE, READ_WRITE | NEVER_RUN);
    __asm volatile("dsb\n isb" ::: "memory");
}

void reset(void) {
    *(volatile uint32_t *)0xE000ED88 = 0xFu << 20; /* CPACR: full access to the FPU */
    __asm volatile("dsb\n isb" ::: "memory");
    for (volatile uint32_t *to = data_start, *end = data_end; to < end; ++to) *to = data_load[to - data_start];
    for (volatile uint32_t *to = bss_start, *end = bss_end; to < end; ++to) *to = 0;
    protect();
    leave(main());
}

/* On the main stack again: the autopilot's may be what ran over. */
__attribute__((naked)) void fault(void) {
    __asm volatile(" ldr r0, =main_stack_top\n mov sp, r0\n b faulted\n .ltorg");
}

__attribute__((used)) void faulted(void) {
    say("\nthe processor took a fault\n");
    leave(1);
}
