/* Arm's MPS2 boards as QEMU emulates them: timer 0 counts time, the processor's own timer ticks, UART 0 is the link.

   Source: Arm Cortex-M System Design Kit, timer, UART and watchdog; Arm application notes 386 and 500 (addresses, interrupts). */
#include "board.h" /* semihosting, and what start.c needs */
#include "interrupts.h"
#include "port.h"
#include "ring.h"

typedef volatile uint32_t reg;
enum { CLOCK_HZ = 25000000, TICKS_PER_SECOND = 1000 };

static reg *const timer = (reg *)0x40000000;   /* control, value, reload; counts down */
static reg *const uart = (reg *)0x40004000;    /* data, state, control, interrupts, divisor */
static reg *const watchdog = (reg *)0x40008000; /* load, value, control, interrupt; counts down */
static reg *const systick = (reg *)0xE000E010; /* control, reload, value */
static reg *const enable = (reg *)0xE000E100;
static reg *const pending = (reg *)0xE000E200;

enum { DATA, STATE, CONTROL, INTERRUPT, DIVISOR };
enum { TX_FULL = 1, RX_FULL = 2, RX_OVERRUN = 8 };
enum { TX_ON = 1, RX_ON = 2, TX_INTERRUPTS = 4, RX_INTERRUPTS = 8 };
enum { RECEIVED, SENT };

static ring in, out;
static volatile uint32_t lost;
static volatile bool ticked;
static uint32_t last;
static int64_t counted; /* ticks of the 25 MHz clock since the start, up to `last`; in lockstep, units of 100 ns */

static uint32_t masked(void) {
    uint32_t before;
    __asm volatile("mrs %0, primask\n cpsid i" : "=r"(before)::"memory");
    return before;
}

static void unmasked(uint32_t before) { __asm volatile("msr primask, %0" ::"r"(before) : "memory"); }

#ifdef LOCKSTEP
#include "standing_clock.h"

/* Time goes on by a tick whenever all of one's work is done, and is nobody's clock. */
int64_t board_now(void) { return counted; }

#else
/* The timer runs out after 171 s; the tick looks at it a thousand times a second. */
int64_t board_now(void) {
    uint32_t before = masked(), now = timer[1];
    counted += (uint32_t)(last - now);
    last = now;
    int64_t ticks = counted;
    unmasked(before);
    return ticks * 2 / 5;
}
#endif

void board_ticked(void) {
    (void)board_now();
    ticked = true;
}

void board_received(void) {
    uart[INTERRUPT] = 2;
    if (uart[STATE] & RX_OVERRUN) {
        uart[STATE] = RX_OVERRUN;
        ++lost;
    }
    while (uart[STATE] & RX_FULL) {
        uint8_t byte = (uint8_t)uart[DATA];
        if (!ring_put(&in, &byte, 1)) ++lost;
    }
}

void board_sent(void) {
    uint8_t byte;
    uart[INTERRUPT] = 1;
    while (!(uart[STATE] & TX_FULL) && ring_take(&out, &byte)) uart[DATA] = byte;
}

bool board_write(const uint8_t *bytes, size_t n) {
    if (!ring_put(&out, bytes, n)) return false;
    pending[0] = 1u << SENT; /* starts the transmitter if it rests; the handler alone writes to it */
    return true;
}

bool board_read(uint8_t *byte) { return ring_take(&in, byte); }

uint32_t board_lost(void) { return lost; }

/* With interrupts masked, one that comes after the look still wakes the processor. */
#ifdef LOCKSTEP
void board_wait(void) {
    if (!ring_used(&in)) counted += 10000000 / TICKS_PER_SECOND;
}

void board_idle(void) {
#else
void board_wait(void) {
#endif
    uint32_t before = masked();
    if (!ring_used(&in) && !ticked) __asm volatile("dsb\n wfi" ::: "memory");
    ticked = false;
    unmasked(before);
}

#ifdef LOCKSTEP
void board_end(void) { leave(0); }
#endif

bool board_radio(uint16_t us[RADIO_CHANNELS]) {
    (void)us;
    return false; /* these boards have no receiver for the safety pilot */
}

__attribute__((naked)) int semihosting(int operation, const void *argument) {
    (void)operation, (void)argument;
    __asm volatile(" bkpt 0xab\n bx lr");
}

enum { SYS_OPEN = 0x01, SYS_CLOSE = 0x02, SYS_WRITE = 0x05, SYS_READ = 0x06, READ_BINARY = 1, WRITE_BINARY = 5 };

/* In the place of memory that outlasts power: a file beside the image. Two copies, the second inverted. */
static int stored(int mode, int operation, uint64_t copies[2]) {
    static const char name[] = "stamp.bin";
    const uint32_t open[] = {(uint32_t)(uintptr_t)name, (uint32_t)mode, sizeof name - 1};
    int file = semihosting(SYS_OPEN, open);
    if (file == -1) return 0;
    const uint32_t move[] = {(uint32_t)file, (uint32_t)(uintptr_t)copies, 16};
    int left = semihosting(operation, move);
    (void)semihosting(SYS_CLOSE, move);
    return left == 0;
}

void board_remember(uint64_t number) {
    uint64_t copies[2] = {number, ~number};
    (void)stored(WRITE_BINARY, SYS_WRITE, copies);
}

uint64_t board_recall(void) {
    uint64_t copies[2];
    return stored(READ_BINARY, SYS_READ, copies) && copies[0] == ~copies[1] ? copies[0] : 0;
}

/* In the place of flash that is not in the program: the emulator puts the key there (make run). */
const uint8_t *board_key(void) { return (const uint8_t *)KEY_ADDRESS; }

/* The watchdog runs out twice: the first time it calls, which nothing can mask, the second time it resets. Its period
   is long, for the emulator may be kept waiting by a busy computer, and its clock goes on. */
enum { WATCHDOG_PERIOD = CLOCK_HZ, WATCHDOG_CALLS_AND_RESETS = 3 };
static const uint32_t BARKED = 0x57444F47u;

/* Above the stack, where neither the start nor the loader writes: it outlasts a reset. */
static uint32_t volatile *const note = (uint32_t *)(RAM_ORIGIN + RAM_SIZE - 8);
static uint32_t found;

void board_kick(void) { watchdog[3] = 1; }

void board_expired(void) {
    *note = BARKED;
    for (int i = 0; i < CHANNELS; ++i) board_pulse(i, SAFE_PULSES[i]);
    for (;;) {} /* the second time resets */
}

const char *board_cause(void) { return found == BARKED ? "watchdog" : "power on"; }
const char *board_refusal(void) { return NULL; }
void board_record(const uint32_t record[RECORD_WORDS]) { (void)record; } /* no flash to write */
void board_rest(void) {}

/* Parameters are not kept here: they begin as exported. */
void board_store(int which, float value) { (void)which, (void)value; }

bool board_load(int which, float *value) {
    (void)which, (void)value;
    return false;
}

static const uint32_t PAINT = 0xA5C35A3Cu;
extern uint32_t autopilot_stack[], autopilot_stack_top[];

uint32_t board_stack(void) {
    const uint32_t *at = autopilot_stack;
    while (at < autopilot_stack_top && *at == PAINT) ++at;
    return (uint32_t)(autopilot_stack_top - at) * 4;
}

/* The main program on a stack of its own at the bottom of RAM, below which nothing may be touched: one that is too deep
   faults. Interrupts use the other one. */
void run(void);

__attribute__((naked)) int main(void) {
    __asm volatile(" ldr r0, =autopilot_stack_top\n msr psp, r0\n movs r0, #2\n msr control, r0\n isb\n"
                   " ldr r0, =started\n bx r0\n .ltorg");
}

__attribute__((used)) static void prepare(void) {
    uint32_t *here = (uint32_t *)__builtin_frame_address(0) - 16;
    for (volatile uint32_t *at = autopilot_stack; at < here; ++at) *at = PAINT;
    timer[1] = UINT32_MAX;
    timer[2] = UINT32_MAX;
    timer[0] = 1;
    last = UINT32_MAX;
    uart[DIVISOR] = 27; /* 921 600 baud of 25 MHz; the emulator does not wait for it */
    uart[CONTROL] = TX_ON | RX_ON | TX_INTERRUPTS | RX_INTERRUPTS;
    enable[0] = 1u << RECEIVED | 1u << SENT;
    found = *note;
    *note = 0;
    watchdog[0] = WATCHDOG_PERIOD;
#ifndef LOCKSTEP
    watchdog[2] = WATCHDOG_CALLS_AND_RESETS; /* not where time stands still for others */
#endif
    systick[1] = CLOCK_HZ / TICKS_PER_SECOND - 1;
    systick[2] = 0;
    systick[0] = 7;
}

__attribute__((used, noreturn)) void started(void) {
    prepare();
    for (;;) run();
}
