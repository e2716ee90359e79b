#define _GNU_SOURCE
#include "uart.h"

#include <avr_uart.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

enum { BYTE_CYCLES = 1504 };

static avr_t *avr;
static void (*on_line)(const char *line);
static enum uart_end end = UART_PTY;
static int pty = -1;

/* Bytes on their way to the board, and the line it is sending. */
static uint8_t rx_queue[1 << 16];
static size_t rx_head, rx_tail;
static char said[512];
static size_t said_length;

static avr_cycle_count_t next_byte(avr_t *of, avr_cycle_count_t when, void *unused)
{
    (void)of, (void)unused;
    if (rx_tail == rx_head) {
        return 0;
    }
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), rx_queue[rx_tail]);
    rx_tail = (rx_tail + 1) % sizeof rx_queue;
    return when + BYTE_CYCLES;
}

void uart_to_board(const uint8_t *bytes, size_t count)
{
    const bool idle = rx_head == rx_tail;
    for (size_t i = 0; i < count; i++) {
        rx_queue[rx_head] = bytes[i];
        rx_head = (rx_head + 1) % sizeof rx_queue;
    }
    if (idle && count > 0 && avr_cycle_timer_status(avr, next_byte, NULL) == 0) {
        avr_cycle_timer_register(avr, BYTE_CYCLES, next_byte, NULL);
    }
}

static void on_byte(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    const uint8_t byte = (uint8_t)value;
    if (end == UART_PTY && pty >= 0) {
        /* Bytes that no one listens to are lost, as on a real wire. */
        const ssize_t written = write(pty, &byte, 1);
        (void)written;
    }
    if (byte != '\n' && said_length + 1 < sizeof said) {
        said[said_length++] = (char)byte;
        return;
    }
    said[said_length] = '\0';
    said_length = 0;
    on_line(said);
}

void uart_attach(avr_t *to, void (*heard)(const char *line))
{
    avr = to;
    on_line = heard;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
}

void uart_lead_to(enum uart_end to)
{
    end = to;
}

enum uart_end uart_leads_to(void)
{
    return end;
}

void uart_reset(void)
{
    said_length = 0;
    rx_tail = rx_head;
}

bool uart_plug(char *path, size_t size)
{
    if (pty >= 0) {
        return false;
    }
    pty = posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC | O_NONBLOCK);
    if (pty < 0 || grantpt(pty) != 0 || unlockpt(pty) != 0 || ptsname_r(pty, path, size) != 0) {
        return false;
    }
    const int slave = open(path, O_RDWR | O_NOCTTY | O_CLOEXEC);
    struct termios line;
    if (slave < 0 || tcgetattr(slave, &line) != 0) {
        return false;
    }
    cfmakeraw(&line);
    const bool set = tcsetattr(slave, TCSANOW, &line) == 0;
    close(slave);
    return set;
}

void uart_unplug(void)
{
    close(pty);
    pty = -1;
}

void uart_read_terminal(void)
{
    uint8_t bytes[256];
    const ssize_t count = pty >= 0 ? read(pty, bytes, sizeof bytes) : 0;
    if (count > 0 && end == UART_PTY) {
        uart_to_board(bytes, (size_t)count);
    }
}
