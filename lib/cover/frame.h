/// The frame: the box in which a surrogate lives, and the integers in which it is exact.
///
/// All lengths are whole *quanta*. In fixed point a quantum is one device unit; in float it is a power of two of
/// device units (2^quantum_log2), so that quanta and device units convert without loss. The frame's origin and cell
/// edges are whole quanta: an edge compares with a device coordinate exactly, and a point's cell is never in doubt.
///
/// Heights are whole *steps* of 2^lsb_log2 quanta, measured from origin[2] along axis 2. The data's own range takes
/// 2^23 to 2^24 steps, so a step is finer than a float of the range's size can tell. Heights up to as far again beyond
/// the range fit, and in fixed point at least 512 quanta on either side.
#ifndef CANOPY_COVER_FRAME_H
#define CANOPY_COVER_FRAME_H

#include <stdint.h>

#include "lib/status.h"

#define CANOPY_AXIS_ONE (1 << 30)      ///< axis components are multiples of 2^-30
#define CANOPY_SIZE_MIN 4              ///< least m and n
#define CANOPY_SIZE_MAX 1024           ///< largest m and n
#define CANOPY_CELLS_MAX 32            ///< largest number of cells a knot interval
#define CANOPY_RANGE_LOG2 24           ///< the data's height range is at most 2^24 steps
#define CANOPY_FRAME_F32_MAX 0x1p126f  ///< largest coordinate of a float frame's box

enum canopy_side { CANOPY_ABOVE = 0, CANOPY_BELOW = 1 };
enum canopy_scalar { CANOPY_F32 = 0, CANOPY_FX = 1 };

struct canopy_frame {
    int32_t origin[3];     ///< quanta: the corner u = v = 0, and the height that counts as 0
    uint32_t pitch[2];     ///< quanta a knot interval in u and v: multiples of `cells`, at least `cells`
    uint16_t size[2];      ///< m x n coefficients: knot intervals are (m-1) x (n-1)
    uint16_t cells;        ///< Q: the field's cells a knot interval
    int16_t quantum_log2;  ///< a quantum is 2^quantum_log2 device units; 0 in fixed point
    int16_t lsb_log2;      ///< a height step is 2^lsb_log2 quanta
    uint8_t side;          ///< enum canopy_side
    int32_t axis[3][3];    ///< rows: u, v and height axis in device coordinates, times CANOPY_AXIS_ONE
};

/// What a frame is asked to be, beside the box it holds.
struct canopy_grid {
    uint16_t size[2];  ///< m x n, each CANOPY_SIZE_MIN to CANOPY_SIZE_MAX
    uint16_t cells;    ///< Q, 1 to CANOPY_CELLS_MAX; 4 when fitting from points
    uint8_t side;      ///< enum canopy_side
};

/// The smallest frame with axes along x, y and z that holds the box low … high of device points, corners included:
/// its origin is the box's corner on the quantum, its pitch the smallest multiple of Q quanta that reaches the far
/// side. In float the quantum is the smallest power of two for which every cell edge has at most 24 bits.
/// CANOPY_ARGUMENT: the grid is out of range, low > high, or (float) a corner is not within +- CANOPY_FRAME_F32_MAX,
/// where differences of coordinates are still finite. *frame is then unchanged.
enum canopy_status canopy_frame_around_fx(struct canopy_frame *frame, const struct canopy_grid *grid,
                                          const int32_t low[3], const int32_t high[3]);
enum canopy_status canopy_frame_around_f32(struct canopy_frame *frame, const struct canopy_grid *grid,
                                           const float low[3], const float high[3]);

/// In what two frames differ: the first of these.
enum canopy_difference {
    CANOPY_SAME = 0,
    CANOPY_DIFFERENT_SIDE,
    CANOPY_DIFFERENT_SIZE,
    CANOPY_DIFFERENT_CELLS,  ///< a knot interval
    CANOPY_DIFFERENT_QUANTUM,
    CANOPY_DIFFERENT_STEP,  ///< lsb_log2
    CANOPY_DIFFERENT_PITCH,
    CANOPY_DIFFERENT_AXES,
    CANOPY_DIFFERENT_ORIGIN
};

/// Whether two frames are the same, and if not, why not.
enum canopy_difference canopy_frame_difference(const struct canopy_frame *a, const struct canopy_frame *b);

/// The frame's width in quanta along u (axis 0) or v (axis 1): (size - 1) * pitch.
static inline uint64_t canopy_frame_width(const struct canopy_frame *frame, int axis) {
    return (uint64_t)(frame->size[axis] - 1U) * frame->pitch[axis];
}

#endif
