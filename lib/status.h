/// What every call of the library that can fail returns.
///
/// Bad input is a status, never an assertion and never a silent repair. A call that returns anything but
/// CANOPY_OK leaves its object as it was, unless its header says otherwise.
#ifndef CANOPY_STATUS_H
#define CANOPY_STATUS_H

enum canopy_status {
    CANOPY_OK = 0,
    CANOPY_MORE,          ///< bounded work was used up; call again to go on (step functions only)
    CANOPY_ARGUMENT,      ///< an argument is outside the range its header states
    CANOPY_ARENA_SHORT,   ///< the caller's arena has fewer bytes than the size macro asks for
    CANOPY_ARENA_ALIGN,   ///< the caller's arena is not aligned to 8 bytes
    CANOPY_OUT_OF_FRAME,  ///< a point lies outside the frame, sideways or in height
    CANOPY_EMPTY,         ///< there is no data to work on
    CANOPY_RANGE,         ///< a result does not fit the fixed-point format; nothing was published
    CANOPY_NOT_SAFE,      ///< a certificate failed: some bound is on the wrong side
    CANOPY_UNSUPPORTED,   ///< the platform or the device cannot do this
    CANOPY_DROPPED,       ///< the row has left the ring
    CANOPY_AHEAD          ///< the row is not in the ring yet
};

#endif
