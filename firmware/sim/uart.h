/* The simulated board's UART, at line rate, and the pseudo terminal at its other end. */
#ifndef UNLIT_SIM_UART_H
#define UNLIT_SIM_UART_H

#include <sim_avr.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Where it leads: the terminal, the commands of the simulator, or nowhere. */
enum uart_end { UART_PTY, UART_STDIO, UART_OFF };

/* heard gets every line that the board has sent, without its end. */
void uart_attach(avr_t *avr, void (*heard)(const char *line));
void uart_lead_to(enum uart_end end);
enum uart_end uart_leads_to(void);
/* Bytes wait their turn, each a byte's time after the one before. */
void uart_to_board(const uint8_t *bytes, size_t count);
/* The board was reset: what was under way either way is lost. */
void uart_reset(void);
/* A new terminal, and the path of its other side. False if one is plugged in already, or the system has none. */
bool uart_plug(char *path, size_t size);
void uart_unplug(void);
/* Takes what the host has written into the terminal. */
void uart_read_terminal(void);

#endif
