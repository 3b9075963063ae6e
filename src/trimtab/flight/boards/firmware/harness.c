/* Run the autopilot through STEPS rows of inputs. Print these lines, with all numbers in hexadecimal:
     sizes PARAMS STATE IN OUT WORK sizes (bytes) of the four structures and of the workspace
     empty TICKS                    ticks of a function of 1 instruction
     loop N TICKS                   ticks of a function of 2 N + 1 instructions
     step TICKS BITS...             for each step: its ticks, and the bits of its outputs as doubles
     stack BYTES                    largest depth of the autopilot's own stack
     done
   defaults, init and the steps run on that stack, all other code on the main stack. */
#include <stdint.h>
#include <string.h>

#include "autopilot.h"
#include "board.h"
#include "vectors.h"

_Static_assert(VECTORS_IN == INPUTS, "vectors.h and vectors.csv disagree on the number of inputs");

extern const double inputs[STEPS][VECTORS_IN];
extern uint32_t autopilot_stack[], autopilot_stack_top[];

static const uint32_t PAINT = 0xA5C35A3Cu;
static autopilot_params params;
static autopilot_state state;
static autopilot_in in;
static autopilot_out out;
#if WORKSPACE
static _Alignas(64) char workspace[WORKSPACE];
#else
static void *const workspace = 0;
#endif

/* The 32-bit timer of the board (CMSDK APB timer 0), which runs at the processor's clock. */
static volatile uint32_t *const timer_control = (volatile uint32_t *)(TIMER_VALUE - 4);
static volatile uint32_t *const timer_value = (volatile uint32_t *)TIMER_VALUE;
static volatile uint32_t *const timer_reload = (volatile uint32_t *)(TIMER_VALUE + 4);
static volatile uint32_t *const timer_ran_out = (volatile uint32_t *)(TIMER_VALUE + 8);

static void say_hex(uint64_t number, int digits) {
    char text[18], *at = text;
    *at++ = ' ';
    while (digits-- > 0) *at++ = "0123456789abcdef"[(number >> (4 * digits)) & 15];
    *at = 0;
    say(text);
}

static uint32_t timed(const void *a, void *b, const void *c, void *d, function *called, void *e) {
    *timer_value = UINT32_MAX;
    uint32_t ticks = measured(a, b, c, d, called, autopilot_stack_top, e);
    if (*timer_ran_out) {
        say("\na step took more than 2^32 ticks of the timer\n");
        leave(1);
    }
    return ticks;
}

static void paint(void) {
    for (volatile uint32_t *at = autopilot_stack, *end = autopilot_stack_top; at < end; ++at) *at = PAINT;
}

static uint32_t painted_over(void) {
    const uint32_t *at = autopilot_stack;
    while (at < autopilot_stack_top && *at == PAINT) ++at;
    return (uint32_t)(autopilot_stack_top - at) * 4;
}

static void say_sizes(void) {
    say("sizes");
    say_hex(sizeof params, 8);
    say_hex(sizeof state, 8);
    say_hex(sizeof in, 8);
    say_hex(sizeof out, 8);
    say_hex(WORKSPACE, 8);
    say("\n");
}

static void calibrate(void) {
    say("empty");
    say_hex(timed(0, 0, 0, 0, nothing, 0), 8);
    for (uintptr_t n = 1; n <= 100000; n *= 10) {
        say("\nloop");
        say_hex(n, 8);
        say_hex(timed((const void *)n, 0, 0, 0, known_loop, 0), 8);
    }
    say("\n");
}

static void fly(void) {
    double row[VECTORS_OUT];
    (void)timed(&params, 0, 0, 0, (function *)autopilot_defaults, 0);
    (void)timed(&params, &state, workspace, 0, (function *)autopilot_init, 0);
    for (unsigned i = 0; i < STEPS; ++i) {
        vectors_set_in(inputs[i], &in);
        say("step");
        say_hex(timed(&params, &state, &in, &out, (function *)autopilot_step, workspace), 8);
        vectors_get_out(&out, row);
        for (int j = 0; j < VECTORS_OUT; ++j) {
            uint64_t bits;
            memcpy(&bits, &row[j], sizeof bits);
            say_hex(bits, 16);
        }
        say("\n");
    }
}

int main(void);
int main(void) {
    *timer_reload = UINT32_MAX;
    *timer_control = 9; /* count, and set a flag at zero; the timer's interrupt is not enabled in the processor */
    paint();
    say_sizes();
    calibrate();
    fly();
    say("stack");
    say_hex(painted_over(), 8);
    say("\ndone\n");
    return 0;
}
