// The trim of small masks, drawn as text. Many random masks against an independent reading of the rule:
// hosttest/test_trim_properties.c.

#include "hosttest/unit/unit.h"
#include "lib/cover/trim.h"
#include "lib/num/bits.h"

enum { M = 7, N = 6, ROOM = CANOPY_TRIM_CORNERS_MOST(M, N) };  // 6 x 5 knot cells

static const uint16_t size[2] = {M, N};
static uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];
static CANOPY_ARENA_DECLARE(arena, CANOPY_TRIM_ARENA(M, N, ROOM));

// Rows from v = 4 down to v = 0, six cells each: as the outline is seen.
static void draw(const char *rows) {
    memset(coverage, 0, sizeof coverage);
    for (uint32_t k = 0; k < 30; k++) {
        if (rows[k] == '#') {
            (void)canopy_bit_set(coverage, k % 6 * (N - 1) + (4 - k / 6));
        }
    }
}

static struct canopy_trim_outline trace(void) {
    struct canopy_trim_outline outline;
    CHECK_EQ(canopy_trim_trace(&outline, size, coverage, ROOM, arena, sizeof arena), CANOPY_OK);
    return outline;
}

static void check_polygon(const struct canopy_trim_outline *outline, uint32_t polygon, uint32_t count,
                          const uint8_t (*corners)[2]) {
    const struct canopy_trim_polygon *p = &outline->polygons[polygon];
    CHECK_EQ(p->count, count);
    for (uint32_t k = 0; k < count; k++) {
        CHECK_EQ(outline->corners[p->first + k].u, corners[k][0]);
        CHECK_EQ(outline->corners[p->first + k].v, corners[k][1]);
    }
}

UNIT(one_cell_is_a_square) {
    draw("......"
         "......"
         "..#..."
         "......"
         "......");
    const struct canopy_trim_outline outline = trace();
    static const uint8_t square[4][2] = {{2, 2}, {3, 2}, {3, 3}, {2, 3}};
    CHECK_EQ(outline.polygon_count, 1);
    check_polygon(&outline, 0, 4, square);
    CHECK_EQ(outline.polygons[0].twice_area, 2);
}

UNIT(staircases_end_in_diagonals) {
    draw("......"
         ".##..."
         "####.."
         "#####."
         ".####.");
    const struct canopy_trim_outline outline = trace();
    static const uint8_t corners[7][2] = {{0, 1}, {1, 0}, {5, 0}, {5, 2}, {3, 4}, {1, 4}, {0, 3}};
    CHECK_EQ(outline.polygon_count, 1);
    CHECK_EQ(outline.polygons[0].twice_area, 2 * 15 + 4);
    check_polygon(&outline, 0, 7, corners);
}

UNIT(the_whole_frame_is_one_rectangle) {
    draw("##############################");
    const struct canopy_trim_outline outline = trace();
    static const uint8_t corners[4][2] = {{0, 0}, {6, 0}, {6, 5}, {0, 5}};
    CHECK_EQ(outline.polygon_count, 1);
    check_polygon(&outline, 0, 4, corners);
    CHECK_EQ(outline.polygons[0].twice_area, 60);
}

UNIT(notches_and_single_holes_stay) {
    draw("######"
         "#.####"
         "######"
         "######"
         "####.#");
    const struct canopy_trim_outline outline = trace();
    CHECK_EQ(outline.polygon_count, 2);
    static const uint8_t hole[4][2] = {{1, 3}, {1, 4}, {2, 4}, {2, 3}};
    check_polygon(&outline, 1, 4, hole);
    CHECK_EQ(outline.polygons[1].twice_area, -2);
    CHECK_EQ(outline.polygons[0].twice_area, 58);
    CHECK_EQ(outline.polygons[0].count, 8);
}

// Where two cells meet at a corner only, triangles join them if they can; two holes that meet so are two.
UNIT(corners_that_touch) {
    draw("......"
         "......"
         ".#...."
         "..#..."
         "......");
    const struct canopy_trim_outline joined = trace();
    CHECK_EQ(joined.polygon_count, 1);
    CHECK_EQ(joined.polygons[0].count, 6);
    CHECK_EQ(joined.polygons[0].twice_area, 6);
    draw("######"
         "##.###"
         "#.####"
         "######"
         "######");
    const struct canopy_trim_outline holes = trace();
    CHECK_EQ(holes.polygon_count, 3);
    uint32_t small = 0;
    for (uint32_t k = 0; k < 3; k++) {
        small += holes.polygons[k].twice_area == -2 && holes.polygons[k].count == 4;
    }
    CHECK_EQ(small, 2);
}

// The outline comes to a knot twice: what lies between is a hole of its own.
UNIT(a_hole_that_touches_the_outside_is_a_hole) {
    draw("######"
         "##.###"
         "#.####"
         "#.####"
         "#.####");
    const struct canopy_trim_outline outline = trace();
    CHECK_EQ(outline.polygon_count, 2);
    CHECK_EQ(outline.polygons[0].twice_area * outline.polygons[1].twice_area < 0, true);
    CHECK_EQ(outline.polygons[0].twice_area + outline.polygons[1].twice_area, 52);
}

UNIT(what_does_not_fit_is_a_status) {
    struct canopy_trim_outline outline;
    char *bytes = (char *)arena;
    draw("......"
         ".##..."
         "####.."
         "#####."
         ".####.");
    CHECK_EQ(canopy_trim_trace(&outline, size, coverage, 7, arena, CANOPY_TRIM_ARENA(M, N, 7)), CANOPY_OK);
    CHECK_EQ(canopy_trim_trace(&outline, size, coverage, 6, arena, CANOPY_TRIM_ARENA(M, N, 6)), CANOPY_RANGE);
    CHECK_EQ(canopy_trim_trace(&outline, size, coverage, 8, arena, CANOPY_TRIM_ARENA(M, N, 8) - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_trim_trace(&outline, size, coverage, 8, bytes + 4, sizeof arena - 4), CANOPY_ARENA_ALIGN);
    draw("..............................");
    CHECK_EQ(canopy_trim_trace(&outline, size, coverage, ROOM, arena, sizeof arena), CANOPY_EMPTY);
}

UNIT(inside_is_decided_exactly_and_edges_belong_to_it) {
    int32_t b[M * N] = {0};
    struct canopy_envelope e = {.frame = {.pitch = {300, 70}, .size = {M, N}}, .coefficients = b, .coverage = coverage};
    draw("......"
         "......"
         "......"
         "#....."
         "##....");
    int32_t low = 5, high = 6;
    CHECK_EQ(canopy_trim_height(&e, 450, 35 + 70, &low, &high), CANOPY_OK);  // in the triangle of cell (1, 1): its edge
    CHECK(low <= 0 && high >= 0);
    low = 5;
    CHECK_EQ(canopy_trim_height(&e, 451, 35 + 70, &low, &high), CANOPY_EMPTY);
    CHECK_EQ(low, 5);
    CHECK(!canopy_trim_holds(&e, 450, 36 + 70));
    CHECK(canopy_trim_holds(&e, 600, 0) && canopy_trim_holds(&e, 600, 70) && !canopy_trim_holds(&e, 601, 0));
    CHECK(canopy_trim_holds(&e, 300, 140) && !canopy_trim_holds(&e, 300, 141) && canopy_trim_holds(&e, 0, 140));
    CHECK_EQ(canopy_trim_height(&e, 1801, 0, &low, &high), CANOPY_OUT_OF_FRAME);
    CHECK(!canopy_trim_holds(&e, 0, 351));
    draw("......"
         "......"
         "......"
         ".....#"
         "....##");
    CHECK(canopy_trim_holds(&e, 1800, 0) && canopy_trim_holds(&e, 1350, 105) && !canopy_trim_holds(&e, 1349, 105));
    e.frame.pitch[0] = UINT32_MAX / 6;  // products of 64 bits
    e.frame.pitch[1] = UINT32_MAX / 5;
    draw("#....."
         ".#...."
         "......"
         "......"
         "......");
    const uint32_t pu = e.frame.pitch[0], pv = e.frame.pitch[1];
    CHECK(canopy_trim_holds(&e, pu + pu / 2, 4 * pv) && !canopy_trim_holds(&e, pu + 1, 5 * pv - 1));
    CHECK(canopy_trim_holds(&e, pu, 5 * pv) && canopy_trim_holds(&e, pu + 1, 5 * pv - 2));
}

UNIT(masks_are_mended_on_a_copy) {
    uint8_t to[sizeof coverage];
    draw("######"
         "#.#..#"
         "######"
         "....##"
         "#.....");
    CHECK_EQ(canopy_trim_close(size, coverage, to), 1);
    CHECK(canopy_bit_get(to, 1 * (N - 1) + 3) && !canopy_bit_get(to, 3 * (N - 1) + 3));
    CHECK_EQ(canopy_trim_clean(size, coverage, to), 1);
    CHECK(!canopy_bit_get(to, 0) && canopy_bit_get(coverage, 0) && canopy_bit_get(to, 4 * (N - 1) + 1));
}

UNIT_LIST(trim, one_cell_is_a_square, staircases_end_in_diagonals, the_whole_frame_is_one_rectangle,
          notches_and_single_holes_stay, corners_that_touch, a_hole_that_touches_the_outside_is_a_hole,
          what_does_not_fit_is_a_status, inside_is_decided_exactly_and_edges_belong_to_it, masks_are_mended_on_a_copy)
