/// Modbus RTU without I/O: bytes and a time go in, bytes come out. A server and a client.
///
/// Source: MODBUS over Serial Line Specification and Implementation Guide V1.02, 2.5. Time is microseconds of any
/// clock that never goes back, the same clock in every call of one object.
///
/// ## How the server finds frames
///
/// A line is shared. The server hears requests to its neighbours and their responses, and has to know where each
/// ends. It does not trust silence alone: USB adapters, ptys and busy hosts swallow silences and invent others. It
/// does not trust length alone either: then one unanswered poll of an absent neighbour makes a server deaf.
///
/// - Bytes are *collected*. Nothing is done about a request to this unit while bytes keep coming.
/// - When the line has been silent for T3.5, what was collected is *read*: as a chain of frames, each found by the
///   length that its function and byte count state and by its CRC, which together must reach exactly the last byte. The
///   chain may start at the beginning of the last burst, or (bytes that came after a pause inside a frame) at an
///   earlier one. The last burst alone is tried first.
/// - Requests to this unit or to all in an accepted chain are carried out in order. Only one that ends the chain is
///   answered: the master has stopped waiting for any other.
/// - A neighbour's frame may be a request or a response; the longer reading with a right CRC counts. While the
///   bytes may still be the head of a response that is awaited, nothing behind them is taken for a frame.
/// - A frame to this unit with a right CRC but a wrong length is answered by exception 03 (one that is too short only
///   when `pause_us` is over, as it might go on), an unknown function by 01.
/// - A silence before bytes is the time between two calls without the time that the bytes of the second take on the
///   wire. On a line that is faster than its baud rate says (a pty, an emulator) that hides silences: give baud 0.
/// - What does not make a chain is kept for `pause_us`, in case the silence was invented and the rest follows; then it
///   is dropped and counted.
/// - If the buffer fills up without a silence, the frame at its beginning is taken by length and CRC; a request to this
///   unit only if another frame follows directly. If there is none, the next burst is tried, and if there is none
///   either, everything is ignored until the next silence.
///
/// ## What holds
///
/// 1. A well-formed request to this unit that comes after a silence of T3.5 and is followed by one is answered, no
///    matter what came before: an absent neighbour, a truncated frame, garbage, an unknown function, a flood.
/// 2. Nothing is carried out unless its CRC is right, it starts where a frame may start (after a silence of T3.5, or
///    directly behind a valid frame) and it ends at a silence or directly before a valid frame. So a request that is
///    only data inside a neighbour's frame is never carried out, however the bytes are cut into calls and whether the
///    silences around that frame are seen or not.
/// 3. A request whose silence before it was swallowed is answered if the frames before it in the same burst are whole
///    and their lengths are known.
/// 4. The answer is offered at T3.5 after the request's last byte, not before. Bytes that come before its first byte
///    is taken withdraw it.
/// 5. Any bytes at any times: no access outside the object, bounded work, and back in step at the next silence.
///
/// ## Where this ends
///
/// - Silences of T3.5 inside a neighbour's frame, exactly before and behind data that are a request to this unit with a
///   right CRC: rule 1 answers it. The same where a late port makes silences appear just there.
/// - A request that lost its last byte is completed by a burst of exactly that byte within `pause_us`. A strict line
///   sets `pause_us` to the silence and has none of this.
/// - A request of an unknown function with an invented silence where its CRC is right already (one in 256 before the
///   last byte): the exception comes that much too early.
/// - A CRC of 16 bits is right by chance once in 65,536 damaged frames.
#ifndef CANOPY_MODBUS_RTU_H
#define CANOPY_MODBUS_RTU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/modbus/pdu.h"
#include "lib/status.h"

#define CANOPY_MODBUS_RTU_ADU_MAX 256      ///< unit, PDU, CRC
#define CANOPY_MODBUS_RTU_PAUSE_US 50000u  ///< pause inside a frame that is forgiven unless configured
#define CANOPY_MODBUS_RTU_TURNAROUND_US 100000u
#define CANOPY_MODBUS_RTU_MARKS 4
#define CANOPY_MODBUS_RTU_NEVER UINT64_MAX

/// T3.5: 3.5 characters of 11 bits up to 19200 baud, 1750 us above, rounded up. Baud 0 counts as above.
uint32_t canopy_modbus_rtu_silence_us(uint32_t baud);

struct canopy_modbus_rtu_server_config {
    const struct canopy_modbus_bank *bank;  ///< must outlive the server
    uint8_t unit;                           ///< 1 to 247
    uint8_t client;                         ///< handed to the bank
    uint8_t character_bits;                 ///< 10 (8N1) or 11; 0 means 11
    uint32_t baud;                          ///< 0: bytes take no time (a pty, an emulator)
    uint32_t silence_us;                    ///< 0: canopy_modbus_rtu_silence_us(baud)
    uint32_t pause_us;                      ///< 0: CANOPY_MODBUS_RTU_PAUSE_US; set it to the silence to forgive none
};

/// The response of a neighbour that is awaited on the line. Private.
struct canopy_modbus_rtu_awaited {
    uint16_t length;  // of the frame, 0 if that cannot be told
    uint8_t unit;     // 0: none is awaited
    uint8_t function;
};

/// About 350 bytes. Everything in it is private; the counters may be read. Not thread-safe.
struct canopy_modbus_rtu_server {
    struct canopy_modbus_rtu_server_config config;
    uint8_t mark_count;
    uint8_t state;
    uint16_t have;          // bytes collected, or length of the reply
    uint16_t sent;          // bytes of the reply that are gone
    uint16_t burst;         // where the last burst starts
    uint64_t last_us;       // when the last byte came or went
    uint32_t character_q8;  // time of a character, us * 256
    uint32_t rx_frames;     ///< valid requests to this unit or to all; monotonic
    uint32_t rx_errors;     ///< times that received bytes were dropped because they were no frames; monotonic
    struct canopy_modbus_rtu_awaited awaited;
    uint16_t marks[CANOPY_MODBUS_RTU_MARKS];  // earlier bursts, oldest first
    uint8_t buffer[CANOPY_MODBUS_RTU_ADU_MAX];
};

/// Copies the configuration. CANOPY_ARGUMENT: no bank or no read/write in it, a unit outside 1..247, character bits
/// other than 0, 10, 11, a pause shorter than the silence. The line counts as silent before.
enum canopy_status canopy_modbus_rtu_server_init(struct canopy_modbus_rtu_server *server,
                                                 const struct canopy_modbus_rtu_server_config *config);

/// Takes all of `length` received bytes, any number and any chunking; `now_us` is when the last of them had arrived
/// (or was noticed: later is allowed and only makes silences look longer). Do not feed what the line echoes of our own
/// sending. Bytes that arrive while a reply is being sent are ignored.
/// May call the bank (when the silence had passed unnoticed). Work: one store a byte; and when a silence has passed,
/// two CRCs over what was collected if that is one frame, at worst (64 frames of four bytes in a row) some 20,000 bytes
/// of CRC at 11 instructions each on a Cortex-M3.
void canopy_modbus_rtu_server_feed(struct canopy_modbus_rtu_server *server, const uint8_t *bytes, size_t length,
                                   uint64_t now_us);

/// Reads what was collected when the silence is over, calling the bank; returns how many bytes wait to be sent now, at
/// *reply (valid until the next call), 0 for none.
size_t canopy_modbus_rtu_server_poll(struct canopy_modbus_rtu_server *server, uint64_t now_us, const uint8_t **reply);

/// Tells that `count` more bytes of the reply were handed to the line; from the first of them on the reply cannot be
/// withdrawn. At most what poll returned counts.
void canopy_modbus_rtu_server_sent(struct canopy_modbus_rtu_server *server, size_t count, uint64_t now_us);

/// Whether a reply has not been handed to the line yet, or not all of it.
bool canopy_modbus_rtu_server_is_replying(const struct canopy_modbus_rtu_server *server);

/// When poll next has something to do, for a timer; CANOPY_MODBUS_RTU_NEVER when nothing is under way. A past time
/// means now.
uint64_t canopy_modbus_rtu_server_due(const struct canopy_modbus_rtu_server *server);

/// ## Client
///
/// One request at a time: start, then each cycle: poll, hand over what `pending` offers, feed what came.
///
/// It keeps T3.5 of silence before a request. A response is found by its length and CRC and must agree with the
/// request in unit, function, byte count and echo; anything else is dropped up to the next silence and counted, and
/// the wait goes on until the timeout. Bytes that come while nothing is awaited (a late answer to a request that
/// timed out) are dropped and put the next request off until the line is silent. RTU has no transaction numbers: a
/// late answer that starts only after the next request of the same shape has gone out cannot be told from its answer;
/// choose the timeout longer than the device's worst response time.
struct canopy_modbus_rtu_client_config {
    uint8_t character_bits;  ///< 10 (8N1) or 11; 0 means 11
    uint32_t baud;           ///< 0: bytes take no time
    uint32_t silence_us;     ///< 0: canopy_modbus_rtu_silence_us(baud)
    uint32_t timeout_us;     ///< from the request's end to the response's start; the wire time is added. Not 0
    uint32_t turnaround_us;  ///< after a broadcast; 0: CANOPY_MODBUS_RTU_TURNAROUND_US
};

/// About 330 bytes. Private but for the counters. Not thread-safe.
struct canopy_modbus_rtu_client {
    struct canopy_modbus_rtu_client_config config;
    uint8_t unit;
    uint8_t state;
    uint16_t have;  // bytes of the request, then of the response
    uint16_t sent;
    uint16_t burst;  // where the last burst starts
    struct canopy_modbus_expected expected;
    uint64_t last_us;  // when the last byte came or went
    uint64_t deadline_us;
    uint32_t character_q8;  // time of a character, us * 256
    uint32_t rx_frames;     ///< responses that answered a request, exceptions included; monotonic
    uint32_t rx_errors;     ///< dropped: wrong CRC, wrong unit, wrong shape, late; monotonic
    uint8_t buffer[CANOPY_MODBUS_RTU_ADU_MAX];
};

/// CANOPY_ARGUMENT: no timeout, or character bits other than 0, 10, 11. `now_us`: the first request waits for a
/// silence from here.
enum canopy_status canopy_modbus_rtu_client_init(struct canopy_modbus_rtu_client *client,
                                                 const struct canopy_modbus_rtu_client_config *config, uint64_t now_us);

/// Starts a request. CANOPY_ARGUMENT if one is pending or no such request exists (pdu.h); the client is unchanged then.
enum canopy_status canopy_modbus_rtu_client_start(struct canopy_modbus_rtu_client *client,
                                                  const struct canopy_modbus_request *request);

/// Bytes to send now, at *bytes: 0 before the silence is over and when all are gone.
size_t canopy_modbus_rtu_client_pending(const struct canopy_modbus_rtu_client *client, uint64_t now_us,
                                        const uint8_t **bytes);
/// Tells that `count` more bytes were handed to the line.
void canopy_modbus_rtu_client_sent(struct canopy_modbus_rtu_client *client, size_t count, uint64_t now_us);

/// Takes all of `length` received bytes; `now_us` as with the server.
void canopy_modbus_rtu_client_feed(struct canopy_modbus_rtu_client *client, const uint8_t *bytes, size_t length,
                                   uint64_t now_us);

/// What has become of the request.
enum canopy_modbus_outcome canopy_modbus_rtu_client_poll(struct canopy_modbus_rtu_client *client, uint64_t now_us);

/// Gives a pending request up; the client is idle then.
void canopy_modbus_rtu_client_abandon(struct canopy_modbus_rtu_client *client);

/// The response's PDU after CANOPY_MODBUS_DONE or CANOPY_MODBUS_REFUSED, else length 0. Valid until the next start.
const uint8_t *canopy_modbus_rtu_client_response(const struct canopy_modbus_rtu_client *client, size_t *length);
/// Copies at most `count` registers that 03, 04 or 23 read, host order; returns how many there were to copy.
size_t canopy_modbus_rtu_client_registers(const struct canopy_modbus_rtu_client *client, uint16_t *to, size_t count);
/// The exception after CANOPY_MODBUS_REFUSED, else 0.
uint8_t canopy_modbus_rtu_client_exception(const struct canopy_modbus_rtu_client *client);

#endif
