/* Registers behind two functions, which a test gives: the drivers of the STM32F405 on a computer. */
#include <stdbool.h>
#include <stdint.h>

static uint32_t (*on_get)(uint32_t);
static void (*on_set)(uint32_t, uint32_t);

uint32_t register_get(uint32_t address) { return on_get(address); }
void register_set(uint32_t address, uint32_t value) { on_set(address, value); }

void model_connect(uint32_t (*get)(uint32_t), void (*set)(uint32_t, uint32_t)) {
    on_get = get;
    on_set = set;
}
