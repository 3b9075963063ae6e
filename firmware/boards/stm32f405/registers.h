/* Registers of the STM32F405 that this board uses, by address; the chapter of each is of ST's reference manual RM0090
   (rev. 19), interrupts' and DMA's numbers are of its tables 62 and 43, the processor's own of Arm's ARMv7-M manual.

   Every access goes through register_get and register_set: on the chip one instruction, with REGISTER_MODEL a call, so
   that the same drivers run on a computer against a model of the registers. */
#ifndef REGISTERS_H
#define REGISTERS_H
#include <stdint.h>

#ifdef REGISTER_MODEL
uint32_t register_get(uint32_t address);
void register_set(uint32_t address, uint32_t value);
#else
static inline uint32_t register_get(uint32_t address) { return *(volatile uint32_t *)address; }
static inline void register_set(uint32_t address, uint32_t value) { *(volatile uint32_t *)address = value; }
#endif

static inline void register_change(uint32_t address, uint32_t clear, uint32_t set) {
    register_set(address, (register_get(address) & ~clear) | set);
}

/* Whether all bits came within so many looks: nothing in this firmware waits without an end. */
static inline int register_await(uint32_t address, uint32_t mask, uint32_t value, uint32_t looks) {
    for (; looks > 0u; --looks)
        if ((register_get(address) & mask) == value) return 1;
    return 0;
}

#define BIT(n) (1u << (n))

/* Independent watchdog, chapter 21. */
#define IWDG_KR 0x40003000u
#define IWDG_PR 0x40003004u
#define IWDG_RLR 0x40003008u
#define IWDG_SR 0x4000300Cu

/* Power, chapter 5; embedded flash, chapter 3; reset and clocks, chapter 7. */
#define PWR_CR 0x40007000u
#define FLASH_ACR 0x40023C00u
#define FLASH_KEYR 0x40023C04u
#define FLASH_OPTKEYR 0x40023C08u
#define FLASH_SR 0x40023C0Cu
#define FLASH_CR 0x40023C10u
#define FLASH_OPTCR 0x40023C14u
#define RCC_CR 0x40023800u
#define RCC_PLLCFGR 0x40023804u
#define RCC_CFGR 0x40023808u
#define RCC_AHB1ENR 0x40023830u
#define RCC_APB1ENR 0x40023840u
#define RCC_APB2ENR 0x40023844u
#define RCC_CSR 0x40023874u

/* Ports, chapter 8; offsets from a port's base. */
#define GPIOA 0x40020000u
#define GPIOB 0x40020400u
#define GPIOC 0x40020800u
#define GPIO_MODER 0x00u
#define GPIO_OTYPER 0x04u
#define GPIO_OSPEEDR 0x08u
#define GPIO_PUPDR 0x0Cu
#define GPIO_IDR 0x10u
#define GPIO_BSRR 0x18u
#define GPIO_AFRL 0x20u

/* General-purpose timers, chapter 18. */
#define TIM2 0x40000000u
#define TIM3 0x40000400u
#define TIM4 0x40000800u
#define TIM5 0x40000C00u
#define TIM_CR1 0x00u
#define TIM_SMCR 0x08u
#define TIM_DIER 0x0Cu
#define TIM_SR 0x10u
#define TIM_EGR 0x14u
#define TIM_CCMR1 0x18u
#define TIM_CCMR2 0x1Cu
#define TIM_CCER 0x20u
#define TIM_CNT 0x24u
#define TIM_PSC 0x28u
#define TIM_ARR 0x2Cu
#define TIM_CCR1 0x34u

/* USART 1, chapter 30. */
#define USART_SR 0x40011000u
#define USART_DR 0x40011004u
#define USART_BRR 0x40011008u
#define USART_CR1 0x4001100Cu
#define USART_CR3 0x40011014u

/* USART 2 and 3, chapter 30; offsets from the base. */
#define USART2 0x40004400u
#define USART3 0x40004800u
#define UART_SR 0x00u
#define UART_DR 0x04u
#define UART_BRR 0x08u
#define UART_CR1 0x0Cu

/* I2C 2, chapter 27. */
#define I2C_CR1 0x40005800u
#define I2C_CR2 0x40005804u
#define I2C_OAR1 0x40005808u
#define I2C_DR 0x40005810u
#define I2C_SR1 0x40005814u
#define I2C_SR2 0x40005818u
#define I2C_CCR 0x4000581Cu
#define I2C_TRISE 0x40005820u

/* SPI 1, chapter 28. */
#define SPI_CR1 0x40013000u
#define SPI_SR 0x40013008u
#define SPI_DR 0x4001300Cu

/* DMA 2, chapter 10: stream 2 of channel 4 receives from USART 1, stream 7 of channel 4 sends to it. */
#define DMA_LISR 0x40026400u
#define DMA_HISR 0x40026404u
#define DMA_LIFCR 0x40026408u
#define DMA_HIFCR 0x4002640Cu
#define DMA_RX 0x40026440u
#define DMA_TX 0x400264B8u
#define DMA_CR 0x00u
#define DMA_NDTR 0x04u
#define DMA_PAR 0x08u
#define DMA_M0AR 0x0Cu

/* The processor's timer, interrupt controller and system control: ARMv7-M B3.2 to B3.4. */
#define SYSTICK_CTRL 0xE000E010u
#define SYSTICK_LOAD 0xE000E014u
#define SYSTICK_VAL 0xE000E018u
#define NVIC_ISER1 0xE000E104u
#define SCB_AIRCR 0xE000ED0Cu
#define SCB_CPACR 0xE000ED88u
#define MPU_CTRL 0xE000ED94u
#define MPU_RBAR 0xE000ED9Cu
#define MPU_RASR 0xE000EDA0u

enum { IRQ_I2C2_EVENT = 33, IRQ_I2C2_ERROR = 34, IRQ_USART1 = 37, IRQ_USART2 = 38, IRQ_USART3 = 39 };
enum { IRQ_TIM5 = 50, IRQ_DMA2_STREAM2 = 58, IRQ_DMA2_STREAM7 = 70 };
#endif
