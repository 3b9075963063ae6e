/* The independent watchdog, brown-out reset, and what the last reset came from. RM0090 chapters 21, 3.6.2 and 7.3.21.

   The watchdog has an oscillator of its own, 17 to 47 kHz, 32 kHz as a rule (data sheet DS8626, table 37). Divided by four
   and 400 counts it resets the chip 50 ms after the last kick: 34 ms at the earliest, 94 ms at the latest. Nothing
   but a reset stops it. An erasure of flash holds the processor up for up to 2 s: patient, it waits 2.7 to 7.5 s. */
#include "board.h"
#include "port.h"
#include "registers.h"

enum { START = 0xCCCC, UNLOCK = 0x5555, KICK = 0xAAAA, BY_4 = 0, BY_64 = 4, LOOKS = 100000 };

void watchdog_period(uint32_t counts, bool patient) {
    register_set(IWDG_KR, UNLOCK);
    (void)register_await(IWDG_SR, 3u, 0u, LOOKS); /* the registers cross into the slow clock's domain */
    register_set(IWDG_PR, patient ? BY_64 : BY_4);
    register_set(IWDG_RLR, counts - 1u);
    (void)register_await(IWDG_SR, 3u, 0u, LOOKS);
    register_set(IWDG_KR, KICK);
}

void watchdog_begin(void) {
    register_set(IWDG_KR, START);
    watchdog_period(WATCHDOG_SHORT, false);
}

void watchdog_kick(void) { register_set(IWDG_KR, KICK); }

void board_kick(void) { watchdog_kick(); }

/* Level 3 of the option bytes, for supplies of 2.7 to 3.6 V, holds the chip in reset where its clock and its flash can't be
   relied on; written where it is another, it holds from the next power-on. */
void brown_out_begin(void) {
    enum { LEVEL = 3 << 2, LEVEL_3 = 0, OPTLOCK = BIT(0), OPTSTRT = BIT(1) };
    if ((register_get(FLASH_OPTCR) & LEVEL) == LEVEL_3) return;
    register_set(FLASH_OPTKEYR, 0x08192A3Bu);
    register_set(FLASH_OPTKEYR, 0x4C5D6E7Fu);
    (void)register_await(FLASH_SR, BIT(16), 0u, LOOKS);
    register_change(FLASH_OPTCR, LEVEL, LEVEL_3);
    register_change(FLASH_OPTCR, 0, OPTSTRT);
    (void)register_await(FLASH_SR, BIT(16), 0u, LOOKS * 100u);
    register_change(FLASH_OPTCR, 0, OPTLOCK);
}

/* The flags stay over resets until they are cleared; a power-on sets brown-out and pin too, a watchdog the pin too. */
const char *reset_cause(void) {
    uint32_t flags = register_get(RCC_CSR);
    register_change(RCC_CSR, 0, BIT(24));
    if (flags & BIT(29)) return "watchdog";
    if (flags & BIT(27)) return "power on";
    if (flags & BIT(28)) return "fault";
    if (flags & BIT(25)) return "brown-out";
    if (flags & BIT(26)) return "reset pin";
    return "start";
}
