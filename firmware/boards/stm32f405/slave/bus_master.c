/* The bus's master: whole transfers, each wait with an end. RM0090 27.3.3. A byte takes 90 us, a piece 1 ms. */
#include "board.h"
#include "i2c.h"
#include "slave_port.h"

enum { LOOKS = 8000 }; /* of some 20 cycles: 1 ms */

static bool await_flag(uint32_t flag) {
    for (uint32_t looks = LOOKS; looks > 0u; --looks) {
        uint32_t status = register_get(I2C_SR1);
        if ((status & (I2C_AF | I2C_BERR | I2C_ARLO)) != 0u) return false;
        if ((status & flag) != 0u) return true;
    }
    return false;
}

/* Start, and an address that was acknowledged. */
static bool address(uint32_t byte, bool acknowledges) {
    if (!register_await(I2C_SR2, I2C_BUSY, 0u, LOOKS)) return false;
    register_set(I2C_CR1, I2C_PE | I2C_START | (acknowledges ? I2C_ACK : 0u));
    if (!await_flag(I2C_SB)) return false;
    register_set(I2C_DR, byte);
    return await_flag(I2C_ADDR);
}

/* The bus is let go; one that stays busy is begun anew, for the peripheral may be what hangs. */
static bool finish(bool good) {
    if (good) return true;
    register_set(I2C_CR1, I2C_PE | I2C_STOP);
    if (!register_await(I2C_SR2, I2C_BUSY, 0u, LOOKS)) {
        i2c_begin();
        register_set(I2C_CR1, I2C_PE);
    }
    register_set(I2C_SR1, ~(uint32_t)(I2C_AF | I2C_BERR | I2C_ARLO | I2C_OVR) & 0xFFFFu);
    return false;
}

static bool send(const uint8_t *bytes, size_t n) {
    if (!address((uint32_t)BUS_ADDRESS << 1, false)) return false;
    (void)register_get(I2C_SR2);
    for (size_t i = 0; i < n; ++i) {
        if (!await_flag(I2C_TXE)) return false;
        register_set(I2C_DR, bytes[i]);
    }
    if (!await_flag(I2C_BTF)) return false;
    register_set(I2C_CR1, I2C_PE | I2C_STOP);
    return true;
}

/* At least three bytes. The last three are special: the acknowledgement of the last is taken back while two wait in the
   data and shift registers, and the stop set before the second last is read. */
static bool receive(uint8_t *bytes, size_t n) {
    if (!address((uint32_t)BUS_ADDRESS << 1 | 1u, true)) return false;
    (void)register_get(I2C_SR2);
    size_t i = 0;
    for (; i + 3u < n; ++i) {
        if (!await_flag(I2C_RXNE)) return false;
        bytes[i] = (uint8_t)register_get(I2C_DR);
    }
    if (!await_flag(I2C_BTF)) return false;
    register_set(I2C_CR1, I2C_PE);
    bytes[i++] = (uint8_t)register_get(I2C_DR);
    if (!await_flag(I2C_BTF)) return false;
    register_set(I2C_CR1, I2C_PE | I2C_STOP);
    bytes[i++] = (uint8_t)register_get(I2C_DR);
    if (!await_flag(I2C_RXNE)) return false;
    bytes[i] = (uint8_t)register_get(I2C_DR);
    return true;
}

void bus_begin(void) {
    i2c_begin();
    register_set(I2C_CR1, I2C_PE);
}

bool slave_bus_write(const uint8_t *bytes, size_t n) { return finish(send(bytes, n)); }

bool slave_bus_read(uint8_t *bytes, size_t n) { return n >= 3u && finish(receive(bytes, n)); }
