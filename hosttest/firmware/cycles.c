// What the work costs on the chip, in instructions: run by hosttest/bench_firmware.py.
//
// Two scenes are made on the device, 400 columns x 344 profiles, 20 x 20 coefficients, Q = 4, side above:
//   hills    value noise of six octaves, as rough as a terrain (the smallest waves are shorter than a field cell)
//   boxes    parts with vertical walls on a plane, some columns without a reading
// `feed` is canopy_field_feed_fx alone, in batches, `feed_f32` the same of points in float; `reading` the whole way of
// a reading through the station. `fit` is canopy_fast from begin to done with lines at the integers, `line` the mean of
// its lines, `certify` the certificate, `refit` both as the station does them, up to the publication, and `refit_10x10`
// the same of 10 x 10 coefficients. A request is what the RTU server does from the first byte to the whole reply.
#include <string.h>

#include "hosttest/firmware/print.h"
#include "hosttest/firmware/scene.h"
#include "lib/modbus/crc.h"
#include "lib/modbus/rtu.h"
#include "lib/station/station.h"
#include "lib/station/turning.h"
#include "port/board.h"

#define M 20
#define N 20
#define CELLS 4
#define SMALL 10
#define LINES 1
#define COLUMNS 400
#define PROFILES 344
#define STEP 30
#define BATCH 200

static CANOPY_ARENA_DECLARE(arena, CANOPY_STATION_ARENA(M, N, CELLS, LINES, 1));
static struct canopy_station station;
static int32_t points[BATCH][3];

// As the board's own station: in float where the processor has it.
#ifdef __ARM_FP
#define FIT (&canopy_line_fit_f32)
static float float_points[BATCH][3];
#else
#define FIT (&canopy_line_fit_fx)
#endif

// ---- Scenes

struct scene {
    const char *name;
    int32_t (*height)(uint32_t x, uint32_t y);
};

static const struct scene scenes[] = {{"hills", hills}, {"boxes", boxes}};

static void make_batch(const struct scene *scene, uint32_t profile, uint32_t column) {
    for (uint32_t i = 0; i < BATCH; i++) {
        points[i][0] = (int32_t)(column + i) * STEP;
        points[i][1] = (int32_t)profile * STEP;
        points[i][2] = scene->height(column + i, profile);
#ifdef __ARM_FP
        for (int a = 0; a < 3; a++)
            float_points[i][a] = (float)points[i][a];
#endif
    }
}

// ---- Results

static void result(const struct scene *scene, const char *name, uint64_t value) {
    print_text(scene->name);
    print_text("_");
    print_result(name, (int64_t)value);
}

// The same of a part of what `name` is.
static void result_of(const struct scene *scene, const char *name, const char *part, uint64_t value) {
    print_text(scene->name);
    print_text("_");
    print_text(name);
    print_result(part, (int64_t)value);
}

static void fail(const char *what) {
    print_text(what);
    print_text("\n");
    canopy_board_exit(false);
}

// ---- Measurements

// All points through `take`; returns instructions a point, times 100.
static uint64_t sweep(const struct scene *scene, void (*take)(void)) {
    uint64_t sum = 0;
    for (uint32_t profile = 0; profile < PROFILES; profile++) {
        for (uint32_t column = 0; column < COLUMNS; column += BATCH) {
            make_batch(scene, profile, column);
            const uint64_t start = canopy_board_instructions();
            take();
            sum += canopy_board_instructions() - start;
        }
    }
    return 100 * sum / (COLUMNS * PROFILES);
}

static void take_feed(void) {
    if (canopy_field_feed_fx(&station.field, (const int32_t(*)[3])points, BATCH) != 0)
        fail("a point was refused");
}

#ifdef __ARM_FP
static void take_feed_f32(void) {
    if (canopy_field_feed_f32(&station.field, (const float(*)[3])float_points, BATCH) != 0)
        fail("a point was refused");
}
#endif

static void take_reading(void) {
    for (uint32_t i = 0; i < BATCH; i++)
        if (canopy_station_reading(&station, points[i], 0, 0) != CANOPY_OK)
            fail("a reading was refused");
}

static void measure_fit(const struct scene *scene) {
    int32_t *coefficients = canopy_plc_begin(&station.plc)->coefficients;
    uint64_t most = 0, lines = 0, start = canopy_board_instructions();
    const uint64_t begin = start;
    if (canopy_fast_begin(&station.fast, coefficients) != CANOPY_OK)
        fail("no fit");
    enum canopy_status status;
    do {
        const uint64_t before = canopy_board_instructions();
        const bool is_line = station.fast.stage == CANOPY_FAST_LINES;
        status = canopy_fast_step(&station.fast, 1);
        const uint64_t one = canopy_board_instructions() - before;
        lines += is_line ? one : 0;
        most = one > most ? one : most;
    } while (status == CANOPY_MORE);
    const uint64_t fit = canopy_board_instructions() - begin;
    result(scene, "fit", fit);
    result(scene, "line", lines / (LINES * (M - 1) + 1));
    result(scene, "fit_solves", station.fast.solves);
    result(scene, "fit_unsettled", station.fast.unsettled);
    result(scene, "fit_longest_step", most);
    start = canopy_board_instructions();
    canopy_certify_begin(&station.certify, coefficients);
    while ((status = canopy_certify_step(&station.certify, 1)) == CANOPY_MORE)
        ;
    const uint64_t certify = canopy_board_instructions() - start;
    result(scene, "certify", certify);
    result(scene, "fit_and_certify", fit + certify);
    if (status != CANOPY_OK)
        fail("the fit of a field at rest must be certified at once");
}

// The station's own way, from the decision to the publication, one unit of work a step.
static void measure_refit(const struct scene *scene, const char *name) {
    uint64_t most = 0;
    const uint64_t start = canopy_board_instructions();
    uint32_t steps = 0;
    while (canopy_plc_published(&station.plc) == NULL && steps++ < 100000) {
        const uint64_t before = canopy_board_instructions();
        canopy_station_step(&station, 1, 1000);
        const uint64_t one = canopy_board_instructions() - before;
        most = one > most ? one : most;
    }
    result(scene, name, canopy_board_instructions() - start);
    result_of(scene, name, "_steps", steps);
    result_of(scene, name, "_longest_step", most);
    if (canopy_plc_published(&station.plc) == NULL || station.published_points != COLUMNS * PROFILES)
        fail("nothing was published");
}

static void begin_station(uint16_t m, uint16_t n) {
    const struct canopy_station_config config = {
        .grid = {.size = {m, n}, .cells = CELLS, .side = CANOPY_ABOVE},
        .fit = FIT,
        .lines = LINES,
        .clients = 1,
        .unit = 1.0F,
        .stale_after_us = 1000000,
        .interval_us = 0,
        .refresh_us = 0,
    };
    const int32_t low[3] = {0, 0, 0}, high[3] = {STEP * (COLUMNS - 1), STEP * (PROFILES - 1), 8192};
    if (canopy_station_init(&station, &config, arena, sizeof arena, 0) != CANOPY_OK ||
        canopy_station_begin_box(&station, low, high) != CANOPY_OK)
        fail("no station");
}

static void measure_scene(const struct scene *scene) {
    begin_station(M, N);
    result(scene, "feed_x100", sweep(scene, take_feed));
#ifdef __ARM_FP
    result(scene, "feed_f32_x100", sweep(scene, take_feed_f32));
#endif
    measure_fit(scene);
    const struct canopy_frame frame = station.field.frame;
    if (canopy_station_begin(&station, &frame) != CANOPY_OK)
        fail("no scene");
    result(scene, "reading_x100", sweep(scene, take_reading));
    measure_refit(scene, "refit");
    // Again, with an envelope published and nothing new: what most readings of a standing scene cost.
    result(scene, "reading_again_x100", sweep(scene, take_reading));
}

static void measure_small(const struct scene *scene) {
    begin_station(SMALL, SMALL);
    (void)sweep(scene, take_reading);
    measure_refit(scene, "refit_10x10");
}

// The same scene seen from 1,2,5, a general direction: a point into the field, and a reading through the station, exact
// and with an uncertainty of two units in z, which is one of the place then.
static struct canopy_station_turned turned;

static void take_turned(void) {
    if (canopy_turn_feed_fx(&station.field, &turned.turn, (const int32_t(*)[3])points, BATCH) != 0)
        fail("a turned point was refused");
}

static void take_uncertain(void) {
    for (uint32_t i = 0; i < BATCH; i++)
        if (canopy_station_reading(&station, points[i], 2, 0) != CANOPY_OK)
            fail("an uncertain reading was refused");
}

static void measure_turned(const struct scene *scene) {
    const int32_t low[3] = {0, 0, 0}, high[3] = {(COLUMNS - 1) * STEP, (PROFILES - 1) * STEP, 8192};
    const int32_t direction[3] = {1, 2, 5};
    struct canopy_station_config config = station.config;
    canopy_station_turned_init(&turned);
    config.turning = &turned.part;
    if (canopy_axes_from_direction_fx(direction, config.axes) != CANOPY_OK ||
        canopy_station_init(&station, &config, arena, sizeof arena, 0) != CANOPY_OK ||
        canopy_station_begin_box(&station, low, high) != CANOPY_OK)
        fail("no turned station");
    result(scene, "turned_feed_x100", sweep(scene, take_turned));
    result(scene, "turned_reading_x100", sweep(scene, take_reading));
    result(scene, "uncertain_reading_x100", sweep(scene, take_uncertain));
}

static void measure_request(const char *name, const uint8_t *body, size_t length) {
    static struct canopy_modbus_rtu_server server;
    static struct canopy_modbus_bank bank;
    bank = canopy_station_bank(&station);
    const struct canopy_modbus_rtu_server_config config = {.bank = &bank, .unit = 1, .baud = 115200};
    if (canopy_modbus_rtu_server_init(&server, &config) != CANOPY_OK)
        fail("no server");
    uint8_t frame[32];
    memcpy(frame, body, length);
    length = canopy_modbus_crc_append(frame, length);
    const uint8_t *reply;
    const uint64_t start = canopy_board_instructions();
    canopy_modbus_rtu_server_feed(&server, frame, length, 1000000);
    if (canopy_modbus_rtu_server_poll(&server, 1010000, &reply) == 0)
        fail("no answer");
    print_result(name, (int64_t)(canopy_board_instructions() - start));
}

int main(void) {
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    for (size_t i = 0; i < sizeof scenes / sizeof scenes[0]; i++)
        measure_scene(&scenes[i]);
    measure_request("request_status", (const uint8_t[]){1, 3, 0, 100, 0, 8}, 6);
    measure_request("request_envelope", (const uint8_t[]){1, 3, 0, 120, 0, 44}, 6);
    measure_request("request_block", (const uint8_t[]){1, 3, 0x27, 0x10, 0, 124}, 6);
    // Writes query_x and query_y, reads the answer: evaluates the surface.
    const uint8_t query[] = {1, 23, 0, 184, 0, 5, 0, 180, 0, 4, 8, 0, 0, 0x10, 0, 0, 0, 0x10, 0};
    measure_request("request_query", query, sizeof query);
    measure_turned(&scenes[0]);
    for (size_t i = 0; i < sizeof scenes / sizeof scenes[0]; i++)
        measure_small(&scenes[i]);
    canopy_board_exit(true);
}
