/// The frame: the box in which a surrogate lives, and the integers in which it is exact.
///
/// All lengths are whole *quanta*. In fixed point a quantum is one device unit; in float it is a power of two of
/// device units (2^quantum_log2), so that quanta and device units convert without loss. The frame's origin and cell
/// edges are whole quanta: an edge compares with a device coordinate exactly, and a point's cell is never in doubt.
///
/// Heights are whole multiples of one `lsb`, 2^lsb_log2 quanta, measured from origin[2] along axis 2.
#ifndef CANOPY_COVER_FRAME_H
#define CANOPY_COVER_FRAME_H

#include <stdint.h>

#define CANOPY_AXIS_ONE (1 << 30)  ///< axis components are multiples of 2^-30

enum canopy_side { CANOPY_ABOVE = 0, CANOPY_BELOW = 1 };
enum canopy_scalar { CANOPY_F32 = 0, CANOPY_FX = 1 };

struct canopy_frame {
    int32_t origin[3];     ///< quanta: the corner u = v = 0, and the height that counts as 0
    uint32_t pitch[2];     ///< quanta a knot interval in u and v: multiples of `cells`, at least `cells`
    uint16_t size[2];      ///< m x n coefficients: knot intervals are (m-1) x (n-1); each at least 4
    uint16_t cells;        ///< Q: field cells a knot interval, 1 to 32
    int16_t quantum_log2;  ///< a quantum is 2^quantum_log2 device units; 0 in fixed point
    int16_t lsb_log2;      ///< a height step is 2^lsb_log2 quanta
    uint8_t side;          ///< enum canopy_side
    int32_t axis[3][3];    ///< rows: u, v and height axis in device coordinates, times CANOPY_AXIS_ONE
};

#endif
