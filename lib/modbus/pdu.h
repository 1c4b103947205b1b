/// What Modbus says, apart from how it is framed: requests, replies and exceptions as PDUs (function code and data).
///
/// A server asks a *bank* for its registers; `canopy_modbus_serve` turns a request PDU into its reply in place.
/// A client describes what it wants in a `canopy_modbus_request`; `canopy_modbus_request_write` makes the PDU and
/// `canopy_modbus_response_check` judges what came back. RTU (rtu.h) and TCP (tcp.h) put frames around these.
///
/// Source: MODBUS Application Protocol Specification V1.1b3. Function codes served: 03, 04, 06, 16, 23 and 43/14.
#ifndef CANOPY_MODBUS_PDU_H
#define CANOPY_MODBUS_PDU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/status.h"

#define CANOPY_MODBUS_PDU_MAX 253       ///< bytes of function code and data
#define CANOPY_MODBUS_READ_MAX 125      ///< registers that one 03, 04 or 23 may read
#define CANOPY_MODBUS_WRITE_MAX 123     ///< registers that one 16 may write
#define CANOPY_MODBUS_EXCHANGE_MAX 121  ///< registers that one 23 may write
#define CANOPY_MODBUS_OBJECT_MAX 244    ///< bytes of an identification object that fit one reply; longer ones are cut

enum canopy_modbus_function {
    CANOPY_MODBUS_READ_HOLDING = 0x03,
    CANOPY_MODBUS_READ_INPUT = 0x04,
    CANOPY_MODBUS_WRITE_ONE = 0x06,
    CANOPY_MODBUS_WRITE = 0x10,
    CANOPY_MODBUS_EXCHANGE = 0x17,  ///< write, then read
    CANOPY_MODBUS_IDENTIFY = 0x2B   ///< with MEI type 14
};

enum canopy_modbus_exception {
    CANOPY_MODBUS_NO_EXCEPTION = 0,
    CANOPY_MODBUS_ILLEGAL_FUNCTION = 1,
    CANOPY_MODBUS_ILLEGAL_ADDRESS = 2,
    CANOPY_MODBUS_ILLEGAL_VALUE = 3,  ///< a quantity, byte count or length that cannot be, or a value refused
    CANOPY_MODBUS_FAILURE = 4,
    CANOPY_MODBUS_BUSY = 6
};

/// Access codes of 43/14.
enum canopy_modbus_identify_code {
    CANOPY_MODBUS_IDENTIFY_BASIC = 1,     ///< stream of objects 0 to 2
    CANOPY_MODBUS_IDENTIFY_REGULAR = 2,   ///< stream of objects 0 to 6
    CANOPY_MODBUS_IDENTIFY_EXTENDED = 3,  ///< answered like regular: that is what is there
    CANOPY_MODBUS_IDENTIFY_ONE = 4        ///< one object
};

/// The registers behind a server, as callbacks. All of them run inside the server's feed or poll, must not block and
/// must not call back into that server. `client` is the number the server was given by whoever owns the connection.
///
/// `read` and `write` return 0 or the exception to answer. The server has checked the quantity (1 to the function's
/// limit) and that address + count <= 65536, nothing else.
struct canopy_modbus_bank {
    void *context;
    /// Puts registers [address, address + count) at `to`: 2 * count bytes, high byte first, any alignment. 03 and 04
    /// show the same registers. After an exception what was written there is ignored.
    uint8_t (*read)(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to);
    /// Takes 2 * count bytes, high byte first, any alignment, as registers [address, address + count): all of them
    /// or, with an exception, none. `function` is the request's (0x06, 0x10 or 0x17): some items want to be whole.
    uint8_t (*write)(void *context, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                     uint8_t function);
    /// Objects of 43/14 as strings that live on: 0 vendor, 1 product code, 2 revision, 3 vendor URL, 4 product name,
    /// 5 model name, 6 application name. NULL where there is none (0 to 2 are then answered empty, as they must
    /// exist). The member itself may be NULL: 43 is then an illegal function.
    const char *(*identify)(void *context, uint8_t object);
    /// May be NULL. Says, without any effect, what `read` would return. With it a function 23 whose read part must
    /// fail writes nothing; without it the write stands although the answer is an exception.
    uint8_t (*readable)(void *context, uint8_t client, uint16_t address, uint16_t count);
};

/// Answers the request in pdu[0, length) in place: `pdu` has room for CANOPY_MODBUS_PDU_MAX bytes and length is 1 to
/// CANOPY_MODBUS_PDU_MAX. Returns the length of the reply, an exception included.
/// A broadcast is answered by nothing: then 0 is returned, writes are done (06, 16 and the write of 23) and everything
/// else is ignored. Work: one walk over the PDU and one or two calls of the bank.
size_t canopy_modbus_serve(const struct canopy_modbus_bank *bank, uint8_t client, bool broadcast, uint8_t *pdu,
                           size_t length);

/// Length of a PDU from its own first bytes; what frames on a serial line are found by.
enum {
    CANOPY_MODBUS_LENGTH_MORE = 0,      ///< more bytes are needed to tell
    CANOPY_MODBUS_LENGTH_OPEN = 0xFFFF  ///< the function does not say: such a PDU ends where the frame ends
};
/// Of a request whose first `have` bytes are at `pdu`. Knows 01-08 (08 with one word of data), 0B, 0C, 0F-11, 14-18
/// and 2B/0E. May exceed CANOPY_MODBUS_PDU_MAX: then it is not a request.
size_t canopy_modbus_request_length(const uint8_t *pdu, size_t have);
/// Of a response, likewise; every exception has two bytes.
size_t canopy_modbus_response_length(const uint8_t *pdu, size_t have);

/// What a client wants. Unused members are 0.
struct canopy_modbus_request {
    uint8_t unit;             ///< 1 to 247; 0 to all (RTU, writing functions only)
    uint8_t function;         ///< enum canopy_modbus_function
    uint16_t address;         ///< first register to read (03, 04, 23) or to write (06, 16)
    uint16_t count;           ///< how many of them; 1 for 06
    uint16_t write_address;   ///< 23 only
    uint16_t write_count;     ///< 23 only
    const uint16_t *values;   ///< what to write (06, 16, 23), host order; read during the call only
    uint8_t identify_code;    ///< 43/14 only: enum canopy_modbus_identify_code
    uint8_t identify_object;  ///< 43/14 only: where the stream starts, or which object
};

/// What a response must agree with: kept by a client from its request, 8 bytes.
struct canopy_modbus_expected {
    uint8_t function;
    uint8_t bytes;    ///< of registers to be read
    uint8_t echo[4];  ///< what 06 and 16 repeat, or the access code of 43/14
};

/// Writes the request's PDU (room for CANOPY_MODBUS_PDU_MAX bytes) and what its response must agree with. Returns the
/// PDU's length, or 0 when no such request exists: another function, a count outside the function's limits,
/// registers beyond 65535, no values, a broadcast that reads. Nothing has been written then.
size_t canopy_modbus_request_write(const struct canopy_modbus_request *request, uint8_t *pdu,
                                   struct canopy_modbus_expected *expected);

enum canopy_modbus_verdict {
    CANOPY_MODBUS_ANSWER,     ///< it answers the request
    CANOPY_MODBUS_EXCEPTION,  ///< it is an exception to the request; the code is pdu[1]
    CANOPY_MODBUS_MISMATCH    ///< it belongs to another request, or is malformed
};
/// Judges a whole response PDU.
enum canopy_modbus_verdict canopy_modbus_response_check(const struct canopy_modbus_expected *expected,
                                                        const uint8_t *pdu, size_t length);

/// Copies at most `count` registers of an answer to 03, 04 or 23, host order; returns how many there were to copy.
size_t canopy_modbus_registers(const struct canopy_modbus_expected *expected, const uint8_t *pdu, uint16_t *to,
                               size_t count);

/// What became of a client's request.
enum canopy_modbus_outcome {
    CANOPY_MODBUS_IDLE,      ///< nothing was asked
    CANOPY_MODBUS_PENDING,   ///< waiting to send, sending, or waiting for the answer
    CANOPY_MODBUS_DONE,      ///< answered; read the registers now, the next start overwrites them
    CANOPY_MODBUS_REFUSED,   ///< answered by an exception
    CANOPY_MODBUS_TIMED_OUT  ///< no valid answer came in time
};

#endif
