#include "port/linux/modbus_client.h"

#include <errno.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <string.h>
#include <termios.h>
#include <time.h>

#include "lib/modbus/rtu.h"
#include "port/linux/clock.h"

enum { BACK_OFF_FIRST_US = 100000, BACK_OFF_MOST_US = 5000000, FRAME_BYTES = 256, CHARACTER_BITS = 11 };

bool canopy_linux_modbus_open(struct canopy_linux_modbus_client *client,
                              const struct canopy_linux_modbus_config *config) {
    memset(client, 0, sizeof *client);
    client->config = *config;
    client->back_off_us = BACK_OFF_FIRST_US;
    const struct canopy_linux_serial_config *serial = &config->serial;
    client->modbus = config->tcp
                         ? modbus_new_tcp_pi(config->host, config->service)
                         : modbus_new_rtu(serial->device, (int)serial->baud, serial->parity, 8, serial->stop_bits);
    if (client->modbus == NULL) {
        return false;
    }
    uint64_t wait_us = config->timeout_us;
    if (!config->tcp) {
        wait_us +=
            (uint64_t)FRAME_BYTES * CHARACTER_BITS * 1000000U / serial->baud;  // a bridge may send the frame whole
    }
    modbus_set_response_timeout(client->modbus, (uint32_t)(wait_us / 1000000U), (uint32_t)(wait_us % 1000000U));
    modbus_set_byte_timeout(client->modbus, config->timeout_us / 1000000U, config->timeout_us % 1000000U);
    return true;
}

uint64_t canopy_linux_modbus_ready_us(const struct canopy_linux_modbus_client *client) {
    return client->connected ? 0 : client->retry_us;
}

static void disconnect(struct canopy_linux_modbus_client *client) {
    if (client->connected) {
        modbus_close(client->modbus);
    }
    client->connected = false;
}

static void back_off(struct canopy_linux_modbus_client *client) {
    client->retry_us = canopy_linux_now_us() + client->back_off_us;
    client->back_off_us = client->back_off_us * 2 < BACK_OFF_MOST_US ? client->back_off_us * 2 : BACK_OFF_MOST_US;
}

// libmodbus takes 9600 for a rate it does not know, and some drivers take another for one they cannot do.
static bool runs_at(int fd, uint32_t baud) {
    struct termios mode;
    speed_t speed;
    return tcgetattr(fd, &mode) == 0 && canopy_linux_speed(baud, &speed) && cfgetospeed(&mode) == speed;
}

static bool connect_line(struct canopy_linux_modbus_client *client) {
    const struct canopy_linux_serial_config *serial = &client->config.serial;
    if (serial->rs485 && modbus_rtu_get_serial_mode(client->modbus) != MODBUS_RTU_RS485) {
        (void)modbus_rtu_set_serial_mode(client->modbus, MODBUS_RTU_RS485);  // an adapter without it switches by itself
    }
    if (!runs_at(modbus_get_socket(client->modbus), serial->baud)) {
        snprintf(client->why, sizeof client->why, "the line does not run at %u baud", serial->baud);
        return false;
    }
    client->quiet_us = canopy_linux_now_us();
    return true;
}

static bool connect_now(struct canopy_linux_modbus_client *client) {
    if (client->connected) {
        return true;
    }
    errno = 0;
    if (modbus_connect(client->modbus) != 0) {
        snprintf(client->why, sizeof client->why, "%s", errno != 0 ? modbus_strerror(errno) : "no such host");
        back_off(client);
        return false;
    }
    client->connected = true;
    if (!client->config.tcp && !connect_line(client)) {
        disconnect(client);
        back_off(client);
        return false;
    }
    return true;
}

static void sleep_until(uint64_t time_us) {
    const struct timespec until = {.tv_sec = (time_t)(time_us / 1000000U),
                                   .tv_nsec = (long)(time_us % 1000000U) * 1000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {}
}

// T3.5 since the last byte that went or came; what trickled in meanwhile is nobody's.
static void keep_silence(struct canopy_linux_modbus_client *client) {
    const uint32_t silence_us = canopy_modbus_rtu_silence_us(client->config.serial.baud);
    sleep_until(client->quiet_us + silence_us);
    for (int i = 0; i < 16 && modbus_flush(client->modbus) > 0; i++) {
        sleep_until(canopy_linux_now_us() + silence_us);
    }
}

static enum canopy_scan_failure failure_of(int error) {
    if (error >= EMBXILFUN && error <= EMBXGTAR) {
        return CANOPY_SCAN_EXCEPTION;
    }
    switch (error) {
    case EMBUNKEXC: return CANOPY_SCAN_EXCEPTION;
    case ETIMEDOUT: return CANOPY_SCAN_TIMEOUT;
    case EMBBADDATA:
    case EMBMDATA: return CANOPY_SCAN_LENGTH;
    case EMBBADCRC:
    case EMBBADSLAVE:
    case EMBBADEXC: return CANOPY_SCAN_CRC;
    default: return CANOPY_SCAN_LINK;
    }
}

static void recover(struct canopy_linux_modbus_client *client, enum canopy_scan_failure failure) {
    if (failure == CANOPY_SCAN_EXCEPTION) {
        client->back_off_us = BACK_OFF_FIRST_US;
        return;
    }
    if (client->config.tcp || failure == CANOPY_SCAN_LINK) {
        disconnect(client);
        back_off(client);
    }
}

bool canopy_linux_modbus_fetch(struct canopy_linux_modbus_client *client, const struct canopy_profile_request *request,
                               uint16_t *registers, enum canopy_scan_failure *failure) {
    if (!connect_now(client)) {
        *failure = CANOPY_SCAN_LINK;
        return false;
    }
    if (!client->config.tcp) {
        keep_silence(client);
    }
    modbus_set_slave(client->modbus, request->unit);
    errno = 0;
    const int count = request->function == 4
                          ? modbus_read_input_registers(client->modbus, request->address, request->count, registers)
                          : modbus_read_registers(client->modbus, request->address, request->count, registers);
    const int error = errno;
    client->quiet_us = canopy_linux_now_us();
    if (count == request->count) {
        client->back_off_us = BACK_OFF_FIRST_US;
        return true;
    }
    *failure = count >= 0 ? CANOPY_SCAN_LENGTH : failure_of(error);
    snprintf(client->why, sizeof client->why, "%s", count >= 0 ? "wrong number of registers" : modbus_strerror(error));
    recover(client, *failure);
    return false;
}

void canopy_linux_modbus_close(struct canopy_linux_modbus_client *client) {
    if (client->modbus != NULL) {
        disconnect(client);
        modbus_free(client->modbus);
    }
    client->modbus = NULL;
}
