/* The addressed end of the bus: a slave controller, master of the bus, writes pieces here and reads a word. By interrupts,
   for each byte has to be dealt with within the time of the next one. RM0090 27.3.2. */
#include <string.h>

#include "board.h"
#include "i2c.h"
#include "port.h"

enum { PIECES = 16, WORD = 10 };

static piece arrived[PIECES];
static volatile uint32_t put;
static uint32_t taken;
static piece coming;
static bool overlong;
static uint8_t word[WORD], leaving[WORD];
static size_t word_n, leaving_n, at;

void bus_begin(void) {
    put = taken = 0;
    coming.n = word_n = leaving_n = at = 0;
    i2c_begin();
    register_set(I2C_OAR1, BIT(14) | (uint32_t)BUS_ADDRESS << 1); /* bit 14 is to be kept at 1 */
    register_set(I2C_CR2, I2C_MHZ | I2C_ITEVTEN | I2C_ITBUFEN | I2C_ITERREN);
    register_set(I2C_CR1, I2C_PE);
    register_set(I2C_CR1, I2C_PE | I2C_ACK);
    register_set(NVIC_ISER1, BIT(IRQ_I2C2_EVENT - 32) | BIT(IRQ_I2C2_ERROR - 32));
}

/* A reader that is too slow loses the newest pieces: what stands behind them would be older still. */
static void end_piece(void) {
    if (coming.n > 0u && !overlong && put - taken < (uint32_t)PIECES) {
        coming.at = board_now();
        arrived[put % PIECES] = coming;
        ++put;
    }
    coming.n = 0;
    overlong = false;
}

static void take_byte(uint8_t byte) {
    if (coming.n == (size_t)PIECE_BYTES) overlong = true;
    else coming.bytes[coming.n++] = byte;
}

/* Reading SR1, then SR2, clears ADDR; reading SR1, then writing CR1, clears STOPF. */
void bus_event(void) {
    uint32_t status = register_get(I2C_SR1);
    if ((status & I2C_ADDR) != 0u) {
        bool sends = (register_get(I2C_SR2) & I2C_TRA) != 0u;
        end_piece(); /* a start without a stop before it */
        if (sends) {
            memcpy(leaving, word, sizeof word);
            leaving_n = word_n;
            at = 0;
        }
    }
    if ((status & I2C_RXNE) != 0u) take_byte((uint8_t)register_get(I2C_DR));
    if ((status & I2C_TXE) != 0u && (status & I2C_ADDR) == 0u) {
        register_set(I2C_DR, at < leaving_n ? leaving[at] : 0xFFu);
        ++at;
    }
    if ((status & I2C_STOPF) != 0u) {
        register_set(I2C_CR1, I2C_PE | I2C_ACK);
        end_piece();
    }
}

/* AF ends what is read from here. The others spoil what was coming: its check tells, if any of it is kept. */
void bus_error(void) {
    uint32_t status = register_get(I2C_SR1);
    register_set(I2C_SR1, ~(uint32_t)(I2C_AF | I2C_BERR | I2C_ARLO | I2C_OVR) & 0xFFFFu);
    if ((status & (I2C_BERR | I2C_ARLO | I2C_OVR)) != 0u) coming.n = 0;
}

bool bus_take(piece *to) {
    if (put == taken) return false;
    *to = arrived[taken % PIECES];
    ++taken;
    return true;
}

void bus_answer(const uint8_t *bytes, size_t n) {
    if (n > (size_t)WORD) return;
    uint32_t before = mask_interrupts();
    memcpy(word, bytes, n);
    word_n = n;
    restore_interrupts(before);
}
