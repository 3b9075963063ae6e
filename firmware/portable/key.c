#include "key.h"

#include <string.h>

static uint64_t little(const uint8_t *bytes, int n) {
    uint64_t number = 0;
    for (int i = n - 1; i >= 0; --i) number = number << 8 | bytes[i];
    return number;
}

static uint32_t crc32(const uint8_t *bytes, int n) {
    uint32_t crc = 0xFFFFFFFFu;
    for (int i = 0; i < n; ++i) {
        crc ^= bytes[i];
        for (int k = 0; k < 8; ++k) crc = crc >> 1 ^ ((crc & 1u) != 0u ? 0xEDB88320u : 0u);
    }
    return ~crc;
}

bool key_read(const uint8_t *image, vehicle_key *to) {
    if (image == NULL || memcmp(image, "trimtab1", 8) != 0) return false;
    if (little(image + 48, 4) != crc32(image, 48)) return false;
    memcpy(to->secret, image + 8, KEY_BYTES);
    to->since = little(image + 40, 8);
    return true;
}
