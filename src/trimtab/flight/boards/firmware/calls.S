@ Calls whose instructions are known one by one, so no compiler writes them.
    .syntax unified
    .thumb

    .macro function name
    .section .text.\name, "ax"
    .global \name
    .type \name, %function
    .thumb_func
\name:
    .endm

@ uint32_t measured(a, b, c, d, called, stack_top, e): called(a, b, c, d, e) on a stack of its own, on which e lies unless
@ it is 0; ticks of the timer between the two readings (it counts down). Between them lie the blx, the instructions of
@ `called`, its return included, and one ldr.
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

@ void nothing(void): 1 instruction.
    function nothing
    bx lr

@ void known_loop(n): 2 n + 1 instructions.
    function known_loop
1:  subs r0, r0, #1
    bne 1b
    bx lr

@ int semihosting(operation, argument)
    function semihosting
    bkpt 0xab
    bx lr

@ The inputs, as the computer wrote them: rows of little-endian doubles.
    .section .rodata.inputs, "a"
    .balign 8
    .global inputs
inputs:
    .incbin "inputs.bin"
