/* Vector table, reset, memory protection and faults.

   A fault makes the outputs safe and resets: what caused it is in the reset's cause, and the watchdog stands behind it. */
#include "board.h"
#include "registers.h"

extern uint32_t data_start[], data_end[], bss_start[], bss_end[], interrupt_stack_top[];
extern const uint32_t data_load[];

int main(void);
void reset(void);
void fault(void);
void faulted(void);

enum { SYSTEM = 16, INTERRUPTS = 82 };

__attribute__((section(".vectors"), used)) static void (*const vectors[SYSTEM + INTERRUPTS])(void) = {
    [0] = (void (*)(void))(uintptr_t)interrupt_stack_top,
    [1] = reset,
    [2] = fault, /* NMI: the clock security system found the crystal dead */
    [3] = fault, [4] = fault, [5] = fault, [6] = fault, [11] = fault, [12] = fault, [14] = fault,
    [15] = board_ticked,
#ifdef ROLE_SLAVE
    [SYSTEM + IRQ_USART2] = unit_interrupt_0,
    [SYSTEM + IRQ_USART3] = unit_interrupt_1,
#else
    [SYSTEM + IRQ_I2C2_EVENT] = bus_event,
    [SYSTEM + IRQ_I2C2_ERROR] = bus_error,
    [SYSTEM + IRQ_USART1] = usart_interrupt,
    [SYSTEM + IRQ_TIM5] = receiver_captured,
    [SYSTEM + IRQ_DMA2_STREAM2] = usart_lapped,
    [SYSTEM + IRQ_DMA2_STREAM7] = usart_sent,
#endif
};

/* ARMv7-M B3.5: region i, its size a power of two. The rest of the address space may not be touched. */
static void allow(uint32_t i, uint32_t origin, uint32_t size_log2, uint32_t how) {
    register_set(MPU_RBAR, origin | BIT(4) | i);
    register_set(MPU_RASR, how | (size_log2 - 1u) << 1 | 1u);
}

static void protect(void) {
    const uint32_t normal = BIT(19), device = BIT(16), read_write = 3u << 24, read_only = 6u << 24, never_run = BIT(28);
    __asm volatile("dmb" ::: "memory");
    allow(0, 0x08000000u, 20, normal | read_only);
    allow(1, 0x20000000u, 17, normal | read_write | never_run);
    allow(2, 0x40000000u, 19, device | read_write | never_run);
    allow(3, 0x08008000u, 15, normal | read_write | never_run); /* journal: sectors 2 and 3 */
    allow(4, 0x080C0000u, 18, normal | read_write | never_run); /* black box: sectors 10 and 11 */
    register_set(MPU_CTRL, 1);
    __asm volatile("dsb\n isb" ::: "memory");
}

void reset(void) {
    register_set(SCB_CPACR, 0xFu << 20); /* full access to the FPU */
    __asm volatile("dsb\n isb" ::: "memory");
    for (volatile uint32_t *to = data_start, *end = data_end; to < end; ++to) *to = data_load[to - data_start];
    for (volatile uint32_t *to = bss_start, *end = bss_end; to < end; ++to) *to = 0;
    protect();
    (void)main();
}

/* On the interrupts' stack: the program's may be what ran over. */
__attribute__((naked)) void fault(void) {
    __asm volatile(" ldr r0, =interrupt_stack_top\n mov sp, r0\n b faulted\n .ltorg");
}

__attribute__((used)) void faulted(void) {
    servo_silence();
    board_reset();
}
