/* SPI 1 at 10.5 MHz, mode 3: A5 clock, A6 in, A7 out, A4 selects the inertial sensor. RM0090 28.3, registers in 28.5. */
#include "board.h"
#include "icm42688.h"
#include "registers.h"

enum { CPHA = BIT(0), CPOL = BIT(1), MASTER = BIT(2), BY_8 = 2 << 3, SPE = BIT(6), SSI = BIT(8), SSM = BIT(9) };
enum { RXNE = BIT(0), TXE = BIT(1), BSY = BIT(7), LOOKS = 1000 };

static void select_chip(bool selected) { register_set(GPIOA + GPIO_BSRR, selected ? BIT(4 + 16) : BIT(4)); }

void spi_begin(void) {
    register_change(RCC_AHB1ENR, 0, BIT(0));
    register_change(RCC_APB2ENR, 0, BIT(12));
    select_chip(false);
    register_change(GPIOA + GPIO_AFRL, 0xFFF00000u, 0x55500000u);
    register_change(GPIOA + GPIO_OSPEEDR, 0xFF00u, 0xAA00u);
    register_change(GPIOA + GPIO_MODER, 0xFF00u, 0xA900u);
    register_set(SPI_CR1, CPHA | CPOL | MASTER | BY_8 | SSI | SSM | SPE);
}

static bool exchange_byte(uint8_t *byte) {
    if (!register_await(SPI_SR, TXE, TXE, LOOKS)) return false;
    register_set(SPI_DR, *byte);
    if (!register_await(SPI_SR, RXNE, RXNE, LOOKS)) return false;
    *byte = (uint8_t)register_get(SPI_DR);
    return true;
}

bool spi_exchange(uint8_t *bytes, size_t n) {
    bool good = true;
    select_chip(true);
    for (size_t i = 0; good && i < n; ++i) good = exchange_byte(bytes + i);
    good = register_await(SPI_SR, BSY, 0u, LOOKS) && good;
    select_chip(false);
    return good;
}
