/* Vector table, reset and faults. Without WITH_INTERRUPTS, no interrupt is in the table, and none is enabled. With it,
   interrupts.h defines TICK, the handler of the processor's timer; NMI, the handler of the non-maskable interrupt;
   INTERRUPTS, a list of the board's handlers from number 0 on; and PERIPHERALS_SIZE, the size of the accessible memory
   from the timer's page on. */
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

/* Allow access to region i of memory, whose size is a power of two. Without memory protection, the board returns 0 for a
   read outside memory, and accepts a write to flash. With protection, both are faults. */
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

/* Return to the main stack: the fault may be an overflow of the autopilot's stack. */
__attribute__((naked)) void fault(void) {
    __asm volatile(" ldr r0, =main_stack_top\n mov sp, r0\n b faulted\n .ltorg");
}

__attribute__((used)) void faulted(void) {
    say("\nthe processor took a fault\n");
    leave(1);
}
