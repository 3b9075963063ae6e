#include "i2c.h"

void i2c_begin(void) {
    register_change(RCC_AHB1ENR, 0, BIT(1));
    register_change(RCC_APB1ENR, 0, BIT(22));
    register_change(GPIOB + GPIO_OTYPER, 0, BIT(10) | BIT(11));
    register_change(GPIOB + GPIO_PUPDR, 15u << 20, 5u << 20); /* weak: the bus needs resistors of its own, 4.7 kohm */
    register_change(GPIOB + GPIO_AFRL + 4u, 0xFF00u, 0x4400u);
    register_change(GPIOB + GPIO_MODER, 15u << 20, 10u << 20);
    register_set(I2C_CR1, I2C_SWRST);
    register_set(I2C_CR1, 0);
    register_set(I2C_CR2, I2C_MHZ);
    register_set(I2C_CCR, 5u * I2C_MHZ); /* 5 us low, 5 us high */
    register_set(I2C_TRISE, I2C_MHZ + 1u);
}
