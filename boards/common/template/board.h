/// The board: its chip, and who emulates it.
///
/// Data of the board for port/mychip, with the document and the section that each is from: addresses of its devices,
/// numbers of their interrupts, frequencies, pins, lengths of its rings.
#ifndef CANOPY_BOARDS_MINE_BOARD_H
#define CANOPY_BOARDS_MINE_BOARD_H

/// Each line's rings, powers of two. Received: a whole Modbus frame, however long the loop is away. To be sent: what
/// the wire takes in 10 ms, longer than the loop is away, so that a frame leaves without gaps.
#define BOARD_RECEIVE_LENGTH 256u
#define BOARD_SEND_LENGTH 128u

#endif
