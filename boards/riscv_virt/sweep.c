#include "boards/riscv_virt/sweep.h"

#define ID 1u
#define UNIT_BITS 0x3DCCCCCDu  // 0.1 as a float
#define PROFILE_END (CANOPY_GENERIC_HEIGHTS + CANOPY_SWEEP_COLUMNS + 1)

// ---- The scene, in whole numbers

// A part: a dome, and its shadow on the side of higher columns.
struct part {
    uint16_t since;  // sweeps before it is there
    int16_t i, j, radius, height;
};

static const struct part PARTS[] = {
    {0, 40, 30, 30, 900}, {0, 115, 40, 40, 700}, {0, 70, 90, 32, 1200}, {1, 128, 92, 24, 1000}, {3, 20, 75, 18, 600},
};

#define PART_COUNT (sizeof PARTS / sizeof PARTS[0])
#define SHADOW 4  // columns

static uint32_t wave(uint32_t at, uint32_t half) {
    const uint32_t in = at % (2u * half);
    return in < half ? in : 2u * half - in;
}

static uint32_t hash(uint32_t i, uint32_t j) {
    uint32_t h = i * 0x9E3779B1u ^ j * 0x85EBCA77u;
    h = (h ^ h >> 15) * 0x2C1B3C6Du;
    return h ^ h >> 13;
}

static bool meets_row(const struct part *part, int32_t j) {
    return j - part->j < part->radius && part->j - j < part->radius;
}

// Over the floor; 0 beside the part.
static uint32_t part_height(const struct part *part, int32_t i, int32_t j) {
    const int32_t di = i - part->i, dj = j - part->j;
    const int32_t square = part->radius * part->radius, left = square - di * di - dj * dj;
    return left > 0 ? (uint32_t)(part->height * left / square) : 0u;
}

uint16_t canopy_sweep_height(uint32_t sweep, uint32_t j, uint32_t i) {
    const uint32_t chance = hash(i, j);
    uint32_t highest = 0;
    bool shadow = chance % 61u == 0;
    for (uint32_t k = 0; k < PART_COUNT; k++) {
        if (sweep < PARTS[k].since || !meets_row(&PARTS[k], (int32_t)j))
            continue;
        const uint32_t here = part_height(&PARTS[k], (int32_t)i, (int32_t)j);
        const uint32_t before = part_height(&PARTS[k], (int32_t)i - SHADOW, (int32_t)j);
        highest = here > highest ? here : highest;
        shadow = shadow || (here == 0 && before != 0);
    }
    if (shadow)
        return CANOPY_GENERIC_INVALID;
    return (uint16_t)(100u + wave(3u * i + 2u * j, 97u) + wave(7u * j + i, 160u) + (chance >> 28) + highest);
}

// ---- The registers

static uint16_t half_of(uint32_t value, uint32_t word) { return (uint16_t)(word == 0 ? value >> 16 : value); }

// Whole 32-bit values of the description, by the address of their first register.
static uint32_t description_value(uint32_t address) {
    switch (address) {
    case CANOPY_GENERIC_D_MAGIC: return CANOPY_GENERIC_MAGIC;
    case CANOPY_GENERIC_D_VERSION: return CANOPY_GENERIC_VERSION << 16 | ID;
    case CANOPY_GENERIC_D_COLUMNS: return (uint32_t)CANOPY_SWEEP_COLUMNS << 16 | CANOPY_SWEEP_PROFILES;
    case CANOPY_GENERIC_D_X_STEP: return CANOPY_SWEEP_X_STEP;
    case CANOPY_GENERIC_D_Z_STEP: return 1u << 16;  // and no uncertainty
    case CANOPY_GENERIC_D_HIGH: return CANOPY_SWEEP_X_STEP * (CANOPY_SWEEP_COLUMNS - 1);
    case CANOPY_GENERIC_D_HIGH + 2: return CANOPY_SWEEP_Y_STEP * (CANOPY_SWEEP_PROFILES - 1);
    case CANOPY_GENERIC_D_HIGH + 4: return CANOPY_SWEEP_HEIGHT_MOST;
    case CANOPY_GENERIC_D_UNIT: return UNIT_BITS;
    default: return 0;  // x start, z offset and the low corner
    }
}

static uint16_t count_valid(uint32_t sweep, uint32_t j) {
    uint16_t count = 0;
    for (uint32_t i = 0; i < CANOPY_SWEEP_COLUMNS; i++)
        count = (uint16_t)(count + (canopy_sweep_height(sweep, j, i) != CANOPY_GENERIC_INVALID));
    return count;
}

static uint16_t profile_register(const struct canopy_sweep *sweep, uint32_t address) {
    const uint32_t turn = sweep->profile / CANOPY_SWEEP_PROFILES, j = sweep->profile % CANOPY_SWEEP_PROFILES;
    const uint32_t at = address - CANOPY_GENERIC_PROFILE;
    const uint16_t sequence = (uint16_t)(sweep->profile % 65535u + 1u);
    switch (at) {
    case CANOPY_GENERIC_P_SEQUENCE: return sequence;
    case CANOPY_GENERIC_P_ID: return ID;
    case CANOPY_GENERIC_P_POSITION:
    case CANOPY_GENERIC_P_POSITION + 1: return half_of(j * CANOPY_SWEEP_Y_STEP, at - CANOPY_GENERIC_P_POSITION);
    case CANOPY_GENERIC_P_VALID: return count_valid(turn, j);
    default:
        return address == PROFILE_END - 1 ? sequence : canopy_sweep_height(turn, j, address - CANOPY_GENERIC_HEIGHTS);
    }
}

static bool is_in_map(uint32_t address, uint32_t count) {
    const uint32_t end = address + count;
    return (address < CANOPY_GENERIC_D_COUNT && end <= CANOPY_GENERIC_D_COUNT) ||
           (address >= CANOPY_GENERIC_PROFILE && end <= PROFILE_END);
}

// ---- The link

static bool begin(void *context, const struct canopy_profile_request *request, uint64_t now_us) {
    struct canopy_sweep *sweep = context;
    if (request->address == CANOPY_GENERIC_PROFILE && sweep->read && now_us >= sweep->due_us) {
        sweep->profile++;
        sweep->read = false;
        sweep->due_us = now_us + CANOPY_SWEEP_PERIOD_US;
    }
    sweep->request = *request;
    sweep->asked = true;
    return true;
}

static enum canopy_scan_link_state poll(void *context, uint64_t now_us, struct canopy_scan_answer *answer) {
    struct canopy_sweep *sweep = context;
    const uint32_t address = sweep->request.address, count = sweep->request.count;
    (void)now_us;
    if (!sweep->asked)
        return CANOPY_SCAN_LINK_PENDING;
    sweep->asked = false;
    if (count > CANOPY_SCAN_READ_MAX || !is_in_map(address, count)) {
        answer->failure = CANOPY_SCAN_EXCEPTION;
        return CANOPY_SCAN_LINK_FAILED;
    }
    for (uint32_t k = 0; k < count; k++)
        answer->registers[k] = address < CANOPY_GENERIC_PROFILE
                                   ? half_of(description_value((address + k) & ~1u), (address + k) & 1u)
                                   : profile_register(sweep, address + k);
    answer->count = count;
    sweep->read = sweep->read || address + count == PROFILE_END;
    return CANOPY_SCAN_LINK_DONE;
}

static void count_faults(void *context, struct canopy_scan_link_counters *to) {
    (void)context;
    *to = (struct canopy_scan_link_counters){0};
}

void canopy_sweep_init(struct canopy_sweep *sweep) { *sweep = (struct canopy_sweep){0}; }

struct canopy_scan_link canopy_sweep_link(struct canopy_sweep *sweep) {
    return (struct canopy_scan_link){.context = sweep, .begin = begin, .poll = poll, .count = count_faults};
}
