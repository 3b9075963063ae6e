@ Functions whose exact instructions must be known, so they are not written by a compiler.
    .syntax unified
    .thumb

    .macro function name
    .section .text.\name, "ax"
    .global \name
    .type \name, %function
    .thumb_func
\name:
    .endm

@ uint32_t measured(a, b, c, d, called, stack_top, e): call called(a, b, c, d, e) on a separate stack. e is pushed onto
@ that stack unless it is 0. Return the ticks between two readings of the timer, which counts down. Between the readings
@ are the blx, the instructions of `called` with its return, and one ldr.
    function measured
    push {r4-r8, lr}
    ldr r4, [sp, #24]
    mov r5, sp
    ldr r6, [sp, #28]
    ldr r7, =TIMER_VALUE
    mov sp, r6
    ldr r6, [r5, #32]
    cbz r6, 1f
    sub sp, sp, #8
    str r6, [sp]
1:
    ldr r8, [r7]
    blx r4
    ldr r0, [r7]
    mov sp, r5
    sub r0, r8, r0
    pop {r4-r8, pc}
    .ltorg

@ void nothing(void): executes 1 instruction.
    function nothing
    bx lr

@ void known_loop(n): executes 2 n + 1 instructions.
    function known_loop
1:  subs r0, r0, #1
    bne 1b
    bx lr

@ int semihosting(operation, argument): pass a request to the emulator.
    function semihosting
    bkpt 0xab
    bx lr

@ Inputs of the steps, from a file: rows of little-endian doubles.
    .section .rodata.inputs, "a"
    .balign 8
    .global inputs
inputs:
    .incbin "inputs.bin"
