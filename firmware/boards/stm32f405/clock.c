/* The clock tree: crystal, PLL, buses, flash wait states. RM0090 chapter 7; PLL limits in 7.3.2, wait states in 3.5.1.

     PLL in 2 MHz = HSE/M or HSI/8,  VCO 336 MHz = 2 MHz x 168,  SYSCLK 168 MHz = VCO/2,  APB1 42 MHz,  APB2 84 MHz */
#include "board.h"
#include "registers.h"

enum { PLL_INPUT_HZ = 2000000, HSI_HZ = 16000000, LOOKS = 200000 };
enum { HSION = BIT(0), HSEON = BIT(16), HSERDY = BIT(17), CSSON = BIT(19), PLLON = BIT(24), PLLRDY = BIT(25) };

static void start_pll(uint32_t divider, uint32_t from_crystal) {
    register_set(RCC_PLLCFGR, divider | 168u << 6 | 0u << 16 | from_crystal << 22 | 7u << 24);
    register_change(RCC_CR, 0, PLLON);
    (void)register_await(RCC_CR, PLLRDY, PLLRDY, LOOKS);
}

bool clock_begin(void) {
    register_change(RCC_APB1ENR, 0, BIT(28)); /* power interface */
    register_change(PWR_CR, 0, BIT(14));      /* regulator scale 1: needed above 144 MHz */
    register_change(RCC_CR, 0, HSEON);
    bool crystal = register_await(RCC_CR, HSERDY, HSERDY, LOOKS);
    register_set(FLASH_ACR, 5u | BIT(8) | BIT(9) | BIT(10)); /* 5 wait states, prefetch, both caches */
    (void)register_await(FLASH_ACR, 7u, 5u, LOOKS);
    start_pll(crystal ? HSE_HZ / PLL_INPUT_HZ : HSI_HZ / PLL_INPUT_HZ, crystal);
    register_change(RCC_CFGR, 0xFCF0u, 5u << 10 | 4u << 13); /* AHB 1, APB1 4, APB2 2 */
    register_change(RCC_CFGR, 3u, 2u);                       /* the PLL drives the processor */
    (void)register_await(RCC_CFGR, 12u, 8u, LOOKS);
    if (crystal) register_change(RCC_CR, 0, CSSON); /* from here on a crystal that stops is a fault */
    return crystal;
}
