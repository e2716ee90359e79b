/*
 * A stand-in for libgphoto2's USB port driver.
 *
 * libgphoto2 loads its port drivers from the folder that IOLIBS names. Built as usb1.so and put there, this file takes
 * the place of the driver that speaks to libusb. Its bus is the folder that UNLIT_STUDIO_USB names: each camera that is
 * plugged in is a Unix socket in it, named by bus and device number as in "001,004". What libgphoto2 writes to the bulk
 * endpoint goes to the socket as it is; what the camera sends comes as `u32 length, bytes`, one such message being one
 * bulk transfer, and is handed out as a bulk endpoint would: at most one transfer a read, and after a transfer whose
 * length is a multiple of the packet size an empty packet, unless the read asked for more than was left.
 *
 * Errors are those of the real driver: no device -52, timeout -10, claimed by another -53, any other -34 and -35.
 * A claim is a lock on a file beside the socket, so that the kernel ends it when its holder dies.
 */

#define _GNU_SOURCE

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include <gphoto2/gphoto2-port-info-list.h>
#include <gphoto2/gphoto2-port-result.h>
#include <gphoto2/gphoto2-port.h>

/* Canon EOS 5DS, as libgphoto2 knows it. */
#define VENDOR 0x04a9
#define PRODUCT 0x3295

#define PACKET 512
#define ADDRESS "usb:"
/* Class request of the still image class: what state the device is in. */
#define GET_DEVICE_STATUS 0x67

/* The table of functions that a port driver gives libgphoto2_port 0.12; its header is not installed. */
typedef struct {
	int (*init)(GPPort *);
	int (*exit)(GPPort *);
	int (*open)(GPPort *);
	int (*close)(GPPort *);
	int (*read)(GPPort *, char *, int);
	int (*check_int)(GPPort *, char *, int, int);
	int (*write)(GPPort *, const char *, int);
	int (*update)(GPPort *);
	int (*get_pin)(GPPort *, GPPin, GPLevel *);
	int (*set_pin)(GPPort *, GPPin, GPLevel);
	int (*send_break)(GPPort *, int);
	int (*flush)(GPPort *, int);
	int (*find_device)(GPPort *, int, int);
	int (*find_device_by_class)(GPPort *, int, int, int);
	int (*clear_halt)(GPPort *, int);
	int (*msg_write)(GPPort *, int, int, int, char *, int);
	int (*msg_read)(GPPort *, int, int, int, char *, int);
	int (*msg_interface_write)(GPPort *, int, int, int, char *, int);
	int (*msg_interface_read)(GPPort *, int, int, int, char *, int);
	int (*msg_class_write)(GPPort *, int, int, int, char *, int);
	int (*msg_class_read)(GPPort *, int, int, int, char *, int);
	int (*seek)(GPPort *, int, int);
	int (*send_scsi_cmd)(GPPort *, int, char *, int, char *, int, char *, int);
	int (*reset)(GPPort *);
} Operations;

struct _GPPortPrivateLibrary {
	/* Bus and device number of the camera that was found, "" before. */
	char device[8];
	int socket;
	int claim;
	/* Bytes of the present transfer that were not read yet. */
	uint32_t left;
	/* An empty packet is due. */
	int empty;
};

static const char *bus(void)
{
	const char *folder = getenv("UNLIT_STUDIO_USB");
	return folder && *folder ? folder : NULL;
}

static int is_device(const char *name)
{
	static const char shape[] = "ddd,ddd";
	size_t i;
	if (strlen(name) != sizeof(shape) - 1)
		return 0;
	for (i = 0; name[i]; i++)
		if (shape[i] == 'd' ? name[i] < '0' || name[i] > '9' : name[i] != shape[i])
			return 0;
	return 1;
}

static int plugged(const char *device)
{
	char path[512];
	if (!bus() || !is_device(device))
		return 0;
	snprintf(path, sizeof(path), "%s/%s", bus(), device);
	return access(path, F_OK) == 0;
}

static int by_name(const struct dirent **a, const struct dirent **b)
{
	return strcmp((*a)->d_name, (*b)->d_name);
}

static int is_entry(const struct dirent *entry)
{
	return is_device(entry->d_name);
}

/* The devices on the bus, in the order of their numbers. */
static int devices(struct dirent ***found)
{
	*found = NULL;
	return bus() ? scandir(bus(), found, is_entry, by_name) : 0;
}

static void free_devices(struct dirent **found, int count)
{
	while (count > 0)
		free(found[--count]);
	free(found);
}

GPPortType gp_port_library_type(void)
{
	return GP_PORT_USB;
}

static int append(GPPortInfoList *list, const char *path, const char *name)
{
	GPPortInfo info;
	int result = gp_port_info_new(&info);
	if (result < GP_OK)
		return result;
	gp_port_info_set_type(info, GP_PORT_USB);
	gp_port_info_set_name(info, name);
	gp_port_info_set_path(info, path);
	result = gp_port_info_list_append(list, info);
	return result < GP_OK ? result : GP_OK;
}

int gp_port_library_list(GPPortInfoList *list)
{
	struct dirent **found;
	char path[32];
	int i, count, result;

	/* A pattern, by which any address is taken for one of this driver. */
	result = append(list, "^usb:", "");
	count = devices(&found);
	for (i = 0; i < count && result == GP_OK; i++) {
		snprintf(path, sizeof(path), ADDRESS "%.7s", found[i]->d_name);
		result = append(list, path, "Universal Serial Bus");
	}
	free_devices(found, count);
	return result;
}

static int driver_init(GPPort *port)
{
	port->pl = calloc(1, sizeof(*port->pl));
	if (!port->pl)
		return GP_ERROR_NO_MEMORY;
	port->pl->socket = port->pl->claim = -1;
	return GP_OK;
}

static int driver_close(GPPort *port)
{
	if (!port || !port->pl)
		return GP_ERROR_BAD_PARAMETERS;
	if (port->pl->socket >= 0)
		close(port->pl->socket);
	if (port->pl->claim >= 0)
		close(port->pl->claim);
	port->pl->socket = port->pl->claim = -1;
	port->pl->left = 0;
	port->pl->empty = 0;
	return GP_OK;
}

static int driver_exit(GPPort *port)
{
	if (port->pl) {
		driver_close(port);
		free(port->pl);
		port->pl = NULL;
	}
	return GP_OK;
}

/* What a broken link means: the device is gone, or it is there and something else went wrong. */
static int broken(GPPort *port, int otherwise)
{
	return plugged(port->pl->device) ? otherwise : GP_ERROR_IO_USB_FIND;
}

static int driver_open(GPPort *port)
{
	struct sockaddr_un address = {.sun_family = AF_UNIX};
	GPPortPrivateLibrary *pl = port->pl;
	char path[512];
	int length;

	if (!plugged(pl->device))
		return GP_ERROR_IO_USB_FIND;
	snprintf(path, sizeof(path), "%s/.%s.lock", bus(), pl->device);
	pl->claim = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
	if (pl->claim < 0)
		return GP_ERROR_IO_USB_CLAIM;
	if (flock(pl->claim, LOCK_EX | LOCK_NB) < 0) {
		driver_close(port);
		return GP_ERROR_IO_USB_CLAIM;
	}
	length = snprintf(address.sun_path, sizeof(address.sun_path), "%s/%s", bus(), pl->device);
	if (length < 0 || (size_t)length >= sizeof(address.sun_path)) {
		driver_close(port);
		return GP_ERROR_BAD_PARAMETERS;
	}
	pl->socket = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
	if (pl->socket < 0 || connect(pl->socket, (struct sockaddr *)&address, sizeof(address)) < 0) {
		driver_close(port);
		return broken(port, GP_ERROR_IO);
	}
	return GP_OK;
}

static int64_t now_ms(void)
{
	struct timespec now;
	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Waits for `events` on the socket until `until`; a timeout of 0 stands for ever, as in libusb. */
static int await(GPPort *port, short events, int64_t until)
{
	struct pollfd wait = {.fd = port->pl->socket, .events = events};
	for (;;) {
		int64_t left = until - now_ms();
		int result = poll(&wait, 1, port->timeout == 0 ? -1 : left > 0 ? (int)left : 0);
		if (result > 0)
			return GP_OK;
		if (result == 0)
			return GP_ERROR_TIMEOUT;
		if (errno != EINTR)
			return GP_ERROR_IO;
	}
}

/* Reads exactly `size` bytes. */
static int receive(GPPort *port, void *bytes, size_t size, int64_t until)
{
	char *at = bytes;
	while (size > 0) {
		int result = await(port, POLLIN, until);
		ssize_t got;
		if (result < GP_OK)
			return result;
		got = recv(port->pl->socket, at, size, 0);
		if (got < 0 && errno == EINTR)
			continue;
		if (got <= 0)
			return broken(port, GP_ERROR_IO_READ);
		at += got;
		size -= (size_t)got;
	}
	return GP_OK;
}

static int driver_read(GPPort *port, char *bytes, int size)
{
	GPPortPrivateLibrary *pl = port->pl;
	int64_t until = now_ms() + port->timeout;
	uint32_t part, whole = pl->left;
	int result;

	if (pl->socket < 0)
		return broken(port, GP_ERROR_IO_READ);
	if (size <= 0)
		return GP_ERROR_BAD_PARAMETERS;
	if (pl->empty) {
		pl->empty = 0;
		return 0;
	}
	if (whole == 0) {
		unsigned char head[4];
		result = receive(port, head, sizeof(head), until);
		if (result < GP_OK)
			return result;
		whole = (uint32_t)head[0] | (uint32_t)head[1] << 8 | (uint32_t)head[2] << 16 | (uint32_t)head[3] << 24;
		pl->left = whole;
	}
	part = whole < (uint32_t)size ? whole : (uint32_t)size;
	result = receive(port, bytes, part, until);
	if (result < GP_OK)
		return result;
	pl->left -= part;
	/* Reads are of whole packets, so what is left is a multiple of them if the transfer was. */
	pl->empty = pl->left == 0 && part == (uint32_t)size && part % PACKET == 0;
	return (int)part;
}

static int driver_write(GPPort *port, const char *bytes, int size)
{
	int64_t until = now_ms() + port->timeout;
	int done = 0;

	if (port->pl->socket < 0)
		return broken(port, GP_ERROR_IO_WRITE);
	while (done < size) {
		int result = await(port, POLLOUT, until);
		ssize_t sent;
		if (result < GP_OK)
			return result;
		sent = send(port->pl->socket, bytes + done, (size_t)(size - done), MSG_NOSIGNAL);
		if (sent < 0 && errno == EINTR)
			continue;
		if (sent <= 0)
			return broken(port, GP_ERROR_IO_WRITE);
		done += (int)sent;
	}
	return done;
}

/* A Canon's events are fetched by GetEvent; nothing ever comes from the interrupt endpoint. */
static int driver_check_int(GPPort *port, char *bytes, int size, int timeout)
{
	(void)bytes;
	(void)size;
	if (!plugged(port->pl->device))
		return GP_ERROR_IO_USB_FIND;
	poll(NULL, 0, timeout > 0 ? timeout : 0);
	return GP_ERROR_TIMEOUT;
}

static int driver_update(GPPort *port)
{
	memcpy(&port->settings.usb, &port->settings_pending.usb, sizeof(port->settings.usb));
	return GP_OK;
}

static int driver_find_device(GPPort *port, int vendor, int product)
{
	struct dirent **found;
	GPPortInfo info;
	char *path;
	int count, result = GP_ERROR_IO_USB_FIND;

	if (vendor != VENDOR || product != PRODUCT)
		return result;
	if (gp_port_get_info(port, &info) < GP_OK || gp_port_info_get_path(info, &path) < GP_OK)
		return GP_ERROR_BAD_PARAMETERS;
	if (strncmp(path, ADDRESS, strlen(ADDRESS)) != 0)
		return result;
	path += strlen(ADDRESS);
	count = devices(&found);
	if (*path ? plugged(path) : count > 0) {
		snprintf(port->pl->device, sizeof(port->pl->device), "%.7s", *path ? path : found[0]->d_name);
		port->settings.usb.config = 1;
		port->settings.usb.interface = 0;
		port->settings.usb.altsetting = 0;
		port->settings.usb.inep = 0x81;
		port->settings.usb.outep = 0x02;
		port->settings.usb.intep = 0x83;
		port->settings.usb.maxpacketsize = PACKET;
		result = GP_OK;
	}
	free_devices(found, count);
	return result;
}

/* The one model of this bus is found by its ids. */
static int driver_find_device_by_class(GPPort *port, int class, int subclass, int protocol)
{
	(void)port;
	(void)class;
	(void)subclass;
	(void)protocol;
	return GP_ERROR_IO_USB_FIND;
}

static int driver_clear_halt(GPPort *port, int endpoint)
{
	(void)endpoint;
	return plugged(port->pl->device) ? GP_OK : GP_ERROR_IO_USB_FIND;
}

static int driver_msg_write(GPPort *port, int request, int value, int index, char *bytes, int size)
{
	(void)request;
	(void)value;
	(void)index;
	(void)bytes;
	return plugged(port->pl->device) ? size : GP_ERROR_IO_USB_FIND;
}

static int driver_msg_read(GPPort *port, int request, int value, int index, char *bytes, int size)
{
	/* Length 4, code "OK". */
	static const char ready[] = {4, 0, 0x01, 0x20};
	(void)value;
	(void)index;
	if (!plugged(port->pl->device))
		return GP_ERROR_IO_USB_FIND;
	if (request != GET_DEVICE_STATUS || size < (int)sizeof(ready))
		return GP_ERROR_IO_READ;
	memcpy(bytes, ready, sizeof(ready));
	return (int)sizeof(ready);
}

static int driver_reset(GPPort *port)
{
	driver_close(port);
	return driver_open(port);
}

Operations *gp_port_library_operations(void)
{
	/* libgphoto2 frees it. */
	Operations *operations = calloc(1, sizeof(*operations));
	if (!operations)
		return NULL;
	operations->init = driver_init;
	operations->exit = driver_exit;
	operations->open = driver_open;
	operations->close = driver_close;
	operations->read = driver_read;
	operations->write = driver_write;
	operations->check_int = driver_check_int;
	operations->update = driver_update;
	operations->find_device = driver_find_device;
	operations->find_device_by_class = driver_find_device_by_class;
	operations->clear_halt = driver_clear_halt;
	operations->msg_write = driver_msg_write;
	operations->msg_read = driver_msg_read;
	operations->msg_interface_write = driver_msg_write;
	operations->msg_interface_read = driver_msg_read;
	operations->msg_class_write = driver_msg_write;
	operations->msg_class_read = driver_msg_read;
	operations->reset = driver_reset;
	return operations;
}
