#include "port/linux/serial.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/serial.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

// What both Linux and libmodbus 3.1.6 know.
static const struct {
    uint32_t baud;
    speed_t speed;
} RATES[] = {
    {110, B110},         {300, B300},         {600, B600},         {1200, B1200},       {2400, B2400},
    {4800, B4800},       {9600, B9600},       {19200, B19200},     {38400, B38400},     {57600, B57600},
    {115200, B115200},   {230400, B230400},   {460800, B460800},   {500000, B500000},   {576000, B576000},
    {921600, B921600},   {1000000, B1000000}, {1152000, B1152000}, {1500000, B1500000}, {2500000, B2500000},
    {3000000, B3000000}, {3500000, B3500000}, {4000000, B4000000},
};

bool canopy_linux_speed(uint32_t baud, speed_t *speed) {
    for (size_t i = 0; i < sizeof RATES / sizeof RATES[0]; i++) {
        if (RATES[i].baud == baud) {
            *speed = RATES[i].speed;
            return true;
        }
    }
    return false;
}

bool canopy_linux_baud_known(uint32_t baud) {
    speed_t speed;
    return canopy_linux_speed(baud, &speed);
}

// Received bytes that the driver counts as lost: framing, overrun, parity, buffer overrun.
static bool count_lost(int fd, uint32_t counts[4]) {
    struct serial_icounter_struct icount;
    memset(&icount, 0, sizeof icount);
    if (ioctl(fd, TIOCGICOUNT, &icount) != 0) {
        return false;
    }
    counts[0] = (uint32_t)icount.frame;
    counts[1] = (uint32_t)icount.overrun;
    counts[2] = (uint32_t)icount.parity;
    counts[3] = (uint32_t)icount.buf_overrun;
    return true;
}

static bool set_raw(int fd, const struct canopy_linux_serial_config *config, speed_t speed) {
    struct termios mode;
    if (tcgetattr(fd, &mode) != 0) {
        return false;
    }
    cfmakeraw(&mode);
    mode.c_cflag &= ~(tcflag_t)(CSIZE | PARENB | PARODD | CSTOPB | CRTSCTS | HUPCL);
    mode.c_cflag |= CS8 | CLOCAL | CREAD;
    mode.c_iflag &= ~(tcflag_t)(INPCK | IGNPAR | IXON | IXOFF | IXANY);
    if (config->parity != 'N') {
        mode.c_cflag |= config->parity == 'O' ? PARENB | PARODD : PARENB;
        mode.c_iflag |= INPCK | IGNPAR;  // a byte with an error is dropped: the frame's CRC then tells
    }
    mode.c_cflag |= config->stop_bits == 2 ? CSTOPB : 0;
    mode.c_cc[VMIN] = 1;  // so that nothing to read is EAGAIN, and 0 a line that has hung up
    mode.c_cc[VTIME] = 0;
    return cfsetispeed(&mode, speed) == 0 && cfsetospeed(&mode, speed) == 0 && tcsetattr(fd, TCSANOW, &mode) == 0;
}

static bool set_rs485(int fd) {
    struct serial_rs485 mode;
    memset(&mode, 0, sizeof mode);
    if (ioctl(fd, TIOCGRS485, &mode) != 0) {
        return false;
    }
    mode.flags |= SER_RS485_ENABLED | SER_RS485_RTS_ON_SEND;
    mode.flags &= ~(uint32_t)(SER_RS485_RTS_AFTER_SEND | SER_RS485_RX_DURING_TX);
    return ioctl(fd, TIOCSRS485, &mode) == 0;
}

static const char *prepare(struct canopy_linux_serial *line, const struct canopy_linux_serial_config *config) {
    speed_t speed;
    if (!canopy_linux_speed(config->baud, &speed)) {
        return "this baud rate is no standard one";
    }
    line->fd = open(config->device, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (line->fd < 0) {
        return strerror(errno);
    }
    if (!isatty(line->fd)) {
        return "this is no serial line";
    }
    if (ioctl(line->fd, TIOCEXCL) != 0 || !set_raw(line->fd, config, speed)) {
        return strerror(errno);
    }
    line->rs485 = config->rs485 && set_rs485(line->fd);
    tcflush(line->fd, TCIOFLUSH);
    line->counts = count_lost(line->fd, line->base);
    return NULL;
}

const char *canopy_linux_serial_open(struct canopy_linux_serial *line,
                                     const struct canopy_linux_serial_config *config) {
    line->fd = -1;
    line->gone = false;
    line->counts = false;
    const char *wrong = prepare(line, config);
    if (wrong != NULL) {
        canopy_linux_serial_close(line);
    }
    return wrong;
}

static uint32_t lost_since_open(const struct canopy_linux_serial *line) {
    uint32_t now[4], lost = 0;
    if (line->fd < 0 || !line->counts || !count_lost(line->fd, now)) {
        return 0;
    }
    for (int i = 0; i < 4; i++) {
        lost += now[i] - line->base[i];
    }
    return lost;
}

void canopy_linux_serial_close(struct canopy_linux_serial *line) {
    if (line->fd >= 0) {
        line->lost += lost_since_open(line);
        (void)ioctl(line->fd, TIOCNXCL);
        close(line->fd);
    }
    line->fd = -1;
}

static void note_error(struct canopy_linux_serial *line) {
    if (errno != EAGAIN && errno != EINTR) {
        line->gone = true;
    }
}

static size_t read_some(void *context, uint8_t *to, size_t length) {
    struct canopy_linux_serial *line = context;
    if (line->fd < 0 || length == 0) {
        return 0;
    }
    const ssize_t count = read(line->fd, to, length);
    if (count < 0) {
        note_error(line);
    }
    line->gone = line->gone || count == 0;
    return count > 0 ? (size_t)count : 0;
}

static size_t write_some(void *context, const uint8_t *from, size_t length) {
    struct canopy_linux_serial *line = context;
    const ssize_t count = line->fd < 0 ? 0 : write(line->fd, from, length);
    if (count < 0) {
        note_error(line);
    }
    return count > 0 ? (size_t)count : 0;
}

static bool all_sent(void *context) {
    const struct canopy_linux_serial *line = context;
    int queued = 0;
    unsigned status = 0;
    if (line->fd < 0 || ioctl(line->fd, TIOCOUTQ, &queued) != 0) {
        return true;
    }
    // Not every driver knows its shift register (a pty has none): then the empty queue is all there is to know.
    return queued == 0 && (ioctl(line->fd, TIOCSERGETLSR, &status) != 0 || (status & TIOCSER_TEMT) != 0);
}

static uint32_t lost(void *context) {
    const struct canopy_linux_serial *line = context;
    return line->lost + lost_since_open(line);
}

struct canopy_stream canopy_linux_serial_stream(struct canopy_linux_serial *line) {
    return (struct canopy_stream){
        .context = line, .read = read_some, .write = write_some, .sent = all_sent, .lost = lost};
}
