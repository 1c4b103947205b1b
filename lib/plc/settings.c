#include "lib/plc/settings.h"

#include <string.h>

#include "canopy_registers.h"
#include "canopy_settings_table.h"

#define ITEMS (sizeof canopy_settings_items / sizeof canopy_settings_items[0])

_Static_assert(ITEMS == CANOPY_SETTINGS && ITEMS <= 32, "a bit of 32 for each setting");

static uint32_t value_of(const struct canopy_settings *settings, const struct canopy_settings_item *item) {
    const unsigned char *member = (const unsigned char *)settings + item->offset;
    uint16_t single;
    uint32_t pair;
    if (item->words == 2) {
        memcpy(&pair, member, sizeof pair);
        return pair;
    }
    memcpy(&single, member, sizeof single);
    return single;
}

static void set(struct canopy_settings *settings, const struct canopy_settings_item *item, uint32_t value) {
    unsigned char *member = (unsigned char *)settings + item->offset;
    const uint16_t single = (uint16_t)value;
    if (item->words == 2) {
        memcpy(member, &value, sizeof value);
    } else {
        memcpy(member, &single, sizeof single);
    }
}

void canopy_settings_defaults(struct canopy_settings *to) {
    for (size_t i = 0; i < ITEMS; i++) {
        set(to, &canopy_settings_items[i], canopy_settings_items[i].initial);
    }
}

bool canopy_settings_are_allowed(const struct canopy_settings *settings, const struct canopy_settings *now,
                                 uint32_t fixed) {
    for (size_t i = 0; i < ITEMS; i++) {
        const struct canopy_settings_item *item = &canopy_settings_items[i];
        const uint32_t value = value_of(settings, item);
        if ((fixed >> i & 1U) != 0 ? value != value_of(now, item) : value < item->low || value > item->high) {
            return false;
        }
    }
    return true;
}

void canopy_settings_encode(const struct canopy_settings *settings, uint8_t *to) {
    for (size_t i = 0; i < ITEMS; i++) {
        const uint32_t value = value_of(settings, &canopy_settings_items[i]);
        for (unsigned left = 2U * canopy_settings_items[i].words; left > 0; left--) {
            *to++ = (uint8_t)(value >> 8U * (left - 1U));
        }
    }
}

bool canopy_settings_decode(struct canopy_settings *settings, const uint8_t *from, size_t length, uint16_t version,
                            uint32_t fixed) {
    struct canopy_settings read = *settings;
    for (size_t i = 0; i < ITEMS && length > 0; i++) {
        const struct canopy_settings_item *item = &canopy_settings_items[i];
        uint32_t value = 0;
        if (length < 2U * item->words) {
            return false;
        }
        for (unsigned k = 0; k < 2U * item->words; k++, length--) {
            value = value << 8 | *from++;
        }
        set(&read, item, value);
    }
    if (version > CANOPY_SETTINGS_VERSION || length > 0 || !canopy_settings_are_allowed(&read, settings, fixed)) {
        return false;
    }
    *settings = read;
    return true;
}
