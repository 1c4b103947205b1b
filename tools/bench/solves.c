#include "tools/bench/solves.h"

#include <stdlib.h>

#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "tools/common/fielding.h"
#include "tools/common/framing.h"

/// Steps through the lines and columns, one solve at a time.
static uint32_t count(struct canopy_fast *fast, struct canopy_bench_solves *solves) {
    while (fast->stage == CANOPY_FAST_LINES || fast->stage == CANOPY_FAST_COLUMNS) {
        uint32_t *histogram = fast->stage == CANOPY_FAST_LINES ? solves->lines : solves->columns;
        const uint32_t before = fast->solves;
        (void)canopy_fast_step(fast, 1);
        if (fast->solves != before) {  // the sum grows when a line is done
            histogram[fast->solves - before]++;
        }
    }
    solves->most = fast->solves > solves->most ? fast->solves : solves->most;
    return fast->solves;
}

static uint32_t fit(struct canopy_bench_solves *solves, const struct canopy_fielding *from, const uint16_t size[2]) {
    const size_t bytes = CANOPY_FAST_ARENA(size[0], size[1], CANOPY_CELLS_MAX, 1);
    void *arena = malloc(bytes);
    int32_t *coefficients = malloc(CANOPY_COEFFICIENTS(size[0], size[1]) * sizeof *coefficients);
    struct canopy_fast fast;
    uint32_t sum = 0;
    if (arena && coefficients &&
        canopy_fast_init(&fast, &from->field, &canopy_line_fit_f32, 1, arena, bytes) == CANOPY_OK &&
        canopy_fast_begin(&fast, coefficients) == CANOPY_OK) {
        sum = count(&fast, solves);
    }
    free(arena);
    free(coefficients);
    return sum;
}

uint32_t canopy_bench_solves_add(struct canopy_bench_solves *solves, const struct canopy_device_list *points,
                                 const uint16_t size[2]) {
    const struct canopy_grid grid = {.size = {size[0], size[1]}, .cells = 4, .side = CANOPY_ABOVE};
    const uint16_t cells[2] = {1, CANOPY_CELLS_MAX};  // what a fit from points tells apart
    const double up[3] = {0.0, 0.0, 1.0};
    int32_t axes[3][3];
    struct canopy_turned turned = {0};
    struct canopy_frame frame;
    struct canopy_fault fault;
    struct canopy_fielding from = {0};
    uint32_t sum = 0;
    if (canopy_turn_axes(up, axes) && canopy_turn(points, axes, &turned, &fault) &&
        canopy_framing_own(&turned, &grid, 0, &frame, &fault) &&
        canopy_fielding_open(&from, &turned, &frame, cells, false, &fault)) {
        sum = fit(solves, &from, size);
        canopy_fielding_close(&from);
    }
    canopy_turned_free(&turned);
    return sum;
}

json_t *canopy_bench_solves_report(const struct canopy_bench_solves *solves) {
    json_t *lines = json_array(), *columns = json_array();
    for (int k = 0; k <= CANOPY_LINE_SOLVES; k++) {
        json_array_append_new(lines, json_integer(solves->lines[k]));
        json_array_append_new(columns, json_integer(solves->columns[k]));
    }
    return json_pack("{s:o, s:o, s:i}", "lines", lines, "columns", columns, "most_of_a_surface", (int)solves->most);
}
