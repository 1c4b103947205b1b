/// The highest or lowest that a surface can be over a window, guaranteed; and with it the clearance between two
/// surfaces or to a plane.
///
/// What comes out is a pair: a *bound*, which the subject passes nowhere on the window, and a value that it *attains*
/// there, with the place. The truth is between the two, so their difference says how loose the bound is. Work can stop
/// after any step; the bound is guaranteed at all times and only gets tighter.
///
///     highest     subject {surface}, CANOPY_HIGHEST
///     lowest      subject {surface}, CANOPY_LOWEST
///     clearance   subject {upper, lower}, CANOPY_LOWEST: upper - lower is nowhere less than the bound, along the
///                 height axis; negative where they may cross
///     to a plane  subject {surface, NULL, &plane}, LOWEST of a surface above it (or minus HIGHEST of one below)
///     change      subject {after, before}: HIGHEST is the largest rise, LOWEST the largest fall
///
/// Method: a spline over a part of a knot cell is between its least and largest Bernstein coefficient, and the corners
/// are values that it attains. First the coefficients that shape the window bound it (B-splines are not negative and
/// sum to one). Then each knot cell is looked at once; then the part with the worst bound is cut in two, again and
/// again (branch and bound), across the direction in which it bends more. Parts that cannot beat what is attained are
/// forgotten. Up to CANOPY_EXTREME_NODES parts, or as many as the caller gives, are remembered; what does not fit stays
/// as loose as it is, and the bound says so.
///
/// All integers, in units of 1/9216 step; everything that is lost to rounding is less than 1/5 step and counted on the
/// safe side. Window edges inside a knot interval are first moved outward to 2^-26 of it: that is the window that
/// everything here is about (a quantum or less, unless the pitch is beyond 2^26 quanta).
///
/// Cost on a Cortex-M3, instructions: begin 25 a coefficient in and around the window; a look at a cell 1,800 (400
/// where its coefficients rule it out, 4,500 where the window's edge crosses it); a cut 7,500. The highest over 6 x 6
/// knot intervals of a scan, to the end, 200,000; docs/queries.md has more. Stack: below 900 bytes.
#ifndef CANOPY_COVER_QUERY_EXTREME_H
#define CANOPY_COVER_QUERY_EXTREME_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/query.h"
#include "lib/cover/query_patch.h"

#define CANOPY_EXTREME_NODES 16  ///< parts that a device remembers: enough for what a scan is
#define CANOPY_EXTREME_DEPTH 16  ///< a knot cell is halved at most so often along each axis

enum canopy_extreme_kind { CANOPY_HIGHEST = 0, CANOPY_LOWEST = 1 };

/// A part of a knot cell that may still hold the extreme. Of the search, no business of the caller.
struct canopy_extreme_node {
    int64_t bound;
    uint16_t cell[2];
    uint16_t index[2];  // which of 2^depth parts of what the window takes of the cell
    uint8_t depth[2];
};

struct canopy_extreme {
    struct canopy_query_subject subject;
    struct canopy_query_rect rect;
    struct canopy_patch_span span[2];
    struct canopy_extreme_node *nodes;  // a heap, the largest bound first
    uint32_t room, count;
    uint32_t next[2];   // the knot cell to be looked at; row beyond the window: all have been
    int32_t sign;       // 1, or -1 for the lowest
    int64_t hull;       // bound from the coefficients around the window
    int64_t rest;       // the largest bound among the parts that are not looked at further
    int64_t best;       // the largest value attained
    int64_t tolerance;  // in patch units, as all four
    bool any;           // a cell of the window counts
    uint32_t at[2];
};

struct canopy_extreme_answer {
    int32_t bound;     ///< steps: the subject is nowhere above (highest) or below (lowest) it
    int32_t attained;  ///< steps: at the place the subject is at least (highest) or at most (lowest) this; valid when
    bool found;        ///< … a place was found: a cell has been looked at
    uint32_t at[2];    ///< the place, quanta from the frame's origin, rounded to the nearest quantum of the window
};

/// Begins. The search ends by itself where bound and attained value are `tolerance` steps apart; 2 is the least that
/// rounding leaves. `nodes` has room for `room` >= 1 parts and stays with the search. Errors as canopy_query_check has
/// them, and CANOPY_RANGE for a coefficient beyond its limit in or around the window; *search is then of no use.
enum canopy_status canopy_extreme_begin(struct canopy_extreme *search, const struct canopy_query_subject *subject,
                                        const struct canopy_query_rect *rect, enum canopy_extreme_kind kind,
                                        uint32_t tolerance, struct canopy_extreme_node *nodes, uint32_t room);

/// At most `budget` units of work, each a look at a knot cell or a cut. CANOPY_MORE; CANOPY_OK: nothing more can be
/// gained; CANOPY_EMPTY: all cells have been looked at and none counts, there is no answer.
/// Looks: the number of knot cells of the window. Cuts: 0 to 10 over a few knot intervals, 40 over a whole scan.
enum canopy_status canopy_extreme_step(struct canopy_extreme *search, uint32_t budget);

/// What is known now; after any number of steps, none included.
struct canopy_extreme_answer canopy_extreme_answer(const struct canopy_extreme *search);

/// The whole of it: begins with CANOPY_EXTREME_NODES parts on the stack (600 bytes more) and works until it ends or
/// `budget` is used up. CANOPY_OK also in the latter case: the answer is guaranteed. Else *answer is unchanged.
enum canopy_status canopy_extreme_find(const struct canopy_query_subject *subject, const struct canopy_query_rect *rect,
                                       enum canopy_extreme_kind kind, uint32_t tolerance, uint32_t budget,
                                       struct canopy_extreme_answer *answer);

#endif
