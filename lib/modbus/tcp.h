/// Modbus TCP without I/O: the bytes of one connection go in, bytes come out. A server and a client.
///
/// Source: MODBUS Messaging on TCP/IP Implementation Guide V1.0b. A frame is transaction (2 bytes), protocol (2, 0),
/// length (2) of what follows, unit, PDU.
///
/// ## Framing, both sides
///
/// - Any chunking; several frames in a row are taken one after the other.
/// - Another protocol, or a length of 0 or 1: the frame is skipped by its length, counted, unanswered.
/// - A length over 254 cannot be Modbus and there is no way back into step: counted, `lost` becomes true, all further
///   bytes are ignored. Close the connection.
/// - Never more than one frame is held, and never more than its own bytes are copied.
///
/// ## How much to feed
///
/// One buffer of one frame is both request and reply. `feed` stops behind a request whose reply is not sent yet and
/// returns how many bytes it took. Either keep the rest and feed it again, or read at most `room` bytes from the
/// socket at a time: those are always all taken. Room 0 is back pressure: send first.
#ifndef CANOPY_MODBUS_TCP_H
#define CANOPY_MODBUS_TCP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/modbus/pdu.h"
#include "lib/status.h"

#define CANOPY_MODBUS_TCP_ADU_MAX 260  ///< transaction, protocol, length, unit, PDU
#define CANOPY_MODBUS_TCP_NEVER UINT64_MAX

/// The receiving half, common to both sides. Private.
struct canopy_modbus_tcp_frame {
    uint16_t have;  // bytes collected
    uint16_t skip;  // bytes to ignore
    bool lost;
    uint8_t adu[CANOPY_MODBUS_TCP_ADU_MAX];
};

struct canopy_modbus_tcp_server_config {
    const struct canopy_modbus_bank *bank;  ///< must outlive the server
    uint8_t unit;                           ///< answered, and so are 0 and 255; requests to others are ignored
    bool any_unit;                          ///< answer all units
    uint8_t client;                         ///< handed to the bank
};

/// One connection; about 310 bytes. Private but for the counters. Not thread-safe.
struct canopy_modbus_tcp_server {
    struct canopy_modbus_tcp_server_config config;
    uint32_t rx_frames;  ///< requests to an accepted unit; monotonic
    uint32_t rx_errors;  ///< frames skipped and streams lost; monotonic
    uint16_t reply;      // length of the reply that waits
    uint16_t sent;
    struct canopy_modbus_tcp_frame frame;
};

/// CANOPY_ARGUMENT: no bank or no read/write in it. Call it again (after saving the counters) for each new connection.
enum canopy_status canopy_modbus_tcp_server_init(struct canopy_modbus_tcp_server *server,
                                                 const struct canopy_modbus_tcp_server_config *config);
/// How many bytes can be fed now such that all are taken; 0 while a reply waits.
size_t canopy_modbus_tcp_server_room(const struct canopy_modbus_tcp_server *server);
/// Takes bytes up to and including the first whole request that is answered; returns how many. Calls the bank.
size_t canopy_modbus_tcp_server_feed(struct canopy_modbus_tcp_server *server, const uint8_t *bytes, size_t length);
/// Bytes of the reply that wait, at *bytes; 0 for none.
size_t canopy_modbus_tcp_server_pending(const struct canopy_modbus_tcp_server *server, const uint8_t **bytes);
/// Tells that the connection took `count` of them (any part).
void canopy_modbus_tcp_server_sent(struct canopy_modbus_tcp_server *server, size_t count);
/// The stream is out of step for good; close the connection.
bool canopy_modbus_tcp_server_lost(const struct canopy_modbus_tcp_server *server);

struct canopy_modbus_tcp_client_config {
    uint32_t timeout_us;  ///< from the request's last byte handed over to the response's last byte. Not 0
};

/// One connection; about 590 bytes. Private but for the counters. Not thread-safe.
///
/// One request at a time. A response must carry the request's transaction number, unit and function and agree with it
/// in byte count and echo; anything else (an answer that comes after its timeout, above all) is dropped and counted.
struct canopy_modbus_tcp_client {
    struct canopy_modbus_tcp_client_config config;
    struct canopy_modbus_expected expected;
    uint64_t deadline_us;
    uint32_t rx_frames;  ///< responses that answered a request, exceptions included; monotonic
    uint32_t rx_errors;  ///< frames dropped; monotonic
    uint16_t transaction;
    uint16_t request;  // length of the request that waits
    uint16_t sent;
    uint8_t unit;
    uint8_t state;
    struct canopy_modbus_tcp_frame frame;
    uint8_t out[CANOPY_MODBUS_TCP_ADU_MAX];
};

/// CANOPY_ARGUMENT: no timeout. For each new connection.
enum canopy_status canopy_modbus_tcp_client_init(struct canopy_modbus_tcp_client *client,
                                                 const struct canopy_modbus_tcp_client_config *config);
/// Starts a request. CANOPY_ARGUMENT if one is pending, the stream is lost, or no such request exists (pdu.h); the
/// client is unchanged then. A request that was partly sent cannot be given up: close the connection.
enum canopy_status canopy_modbus_tcp_client_start(struct canopy_modbus_tcp_client *client,
                                                  const struct canopy_modbus_request *request, uint64_t now_us);
/// Bytes to send, at *bytes; 0 for none.
size_t canopy_modbus_tcp_client_pending(const struct canopy_modbus_tcp_client *client, const uint8_t **bytes);
/// Tells that the connection took `count` of them.
void canopy_modbus_tcp_client_sent(struct canopy_modbus_tcp_client *client, size_t count, uint64_t now_us);
/// How many bytes can be fed now such that all are taken; 0 once the answer is there.
size_t canopy_modbus_tcp_client_room(const struct canopy_modbus_tcp_client *client);
/// Takes bytes up to and including the answer; returns how many. What comes while nothing is awaited stays with the
/// caller: it is sorted out by the next request's wait.
size_t canopy_modbus_tcp_client_feed(struct canopy_modbus_tcp_client *client, const uint8_t *bytes, size_t length);
/// What has become of the request. A lost stream counts as timed out at once.
enum canopy_modbus_outcome canopy_modbus_tcp_client_poll(struct canopy_modbus_tcp_client *client, uint64_t now_us);
bool canopy_modbus_tcp_client_lost(const struct canopy_modbus_tcp_client *client);
/// As their namesakes in rtu.h.
const uint8_t *canopy_modbus_tcp_client_response(const struct canopy_modbus_tcp_client *client, size_t *length);
size_t canopy_modbus_tcp_client_registers(const struct canopy_modbus_tcp_client *client, uint16_t *to, size_t count);
uint8_t canopy_modbus_tcp_client_exception(const struct canopy_modbus_tcp_client *client);

#endif
