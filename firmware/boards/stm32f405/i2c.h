/* I2C 2 on B10 (clock) and B11 (data), 100 kHz: what both ends of the bus have in common. RM0090 chapter 27. */
#ifndef I2C_H
#define I2C_H
#include "registers.h"

enum { I2C_PE = BIT(0), I2C_START = BIT(8), I2C_STOP = BIT(9), I2C_ACK = BIT(10), I2C_SWRST = BIT(15) };
enum { I2C_ITERREN = BIT(8), I2C_ITEVTEN = BIT(9), I2C_ITBUFEN = BIT(10), I2C_MHZ = 42 };
enum { I2C_SB = BIT(0), I2C_ADDR = BIT(1), I2C_BTF = BIT(2), I2C_STOPF = BIT(4), I2C_RXNE = BIT(6), I2C_TXE = BIT(7) };
enum { I2C_BERR = BIT(8), I2C_ARLO = BIT(9), I2C_AF = BIT(10), I2C_OVR = BIT(11) };
enum { I2C_BUSY = BIT(1), I2C_TRA = BIT(2) };
enum { BUS_ADDRESS = 0x42 }; /* of the controller that is not the bus's master */

/* Pins, clock and speed, the peripheral switched off and reset. */
void i2c_begin(void);
#endif
