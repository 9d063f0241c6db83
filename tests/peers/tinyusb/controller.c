/* A USB device controller that is a few arrays: TinyUSB arms endpoints, the host hands over one packet at a time.
 *
 * host_setup, host_out and host_in are the bus. An endpoint that is not armed answers NAK, as hardware does.
 */
#include <string.h>
#include "tusb.h"
#include "device/dcd.h"

enum { NAK = -1, STALLED = -2 };

typedef struct {
  uint8_t *buffer;
  uint16_t length, done, packet;
  bool armed, stalled;
} endpoint_t;

static endpoint_t endpoints[16][2];

static endpoint_t *at(uint8_t address) { return &endpoints[address & 15][address >> 7]; }

bool dcd_init(uint8_t port, const tusb_rhport_init_t *init) {
  (void)port, (void)init;
  return true;
}
bool dcd_deinit(uint8_t port) { return (void)port, true; }
void dcd_int_enable(uint8_t port) { (void)port; }
void dcd_int_disable(uint8_t port) { (void)port; }
void dcd_int_handler(uint8_t port) { (void)port; }
void dcd_remote_wakeup(uint8_t port) { (void)port; }
void dcd_connect(uint8_t port) { (void)port; }
void dcd_disconnect(uint8_t port) { (void)port; }
void dcd_sof_enable(uint8_t port, bool on) { (void)port, (void)on; }
void dcd_set_address(uint8_t port, uint8_t address) { (void)address, dcd_edpt_xfer(port, 0x80, NULL, 0, false); }

bool dcd_edpt_open(uint8_t port, tusb_desc_endpoint_t const *descriptor) {
  (void)port;
  memset(at(descriptor->bEndpointAddress), 0, sizeof(endpoint_t));
  at(descriptor->bEndpointAddress)->packet = tu_edpt_packet_size(descriptor);
  return true;
}
bool dcd_edpt_iso_alloc(uint8_t port, uint8_t address, uint16_t size) { return (void)port, (void)address, (void)size, false; }
bool dcd_edpt_iso_activate(uint8_t port, tusb_desc_endpoint_t const *descriptor) { return (void)port, (void)descriptor, false; }

void dcd_edpt_close_all(uint8_t port) {
  (void)port;
  memset(endpoints[1], 0, sizeof endpoints - sizeof endpoints[0]);
}

bool dcd_edpt_xfer(uint8_t port, uint8_t address, uint8_t *buffer, uint16_t length, bool is_isr) {
  (void)port, (void)is_isr;
  endpoint_t *e = at(address);
  e->buffer = buffer, e->length = length, e->done = 0, e->armed = true;
  return true;
}
void dcd_edpt_stall(uint8_t port, uint8_t address) {
  (void)port;
  at(address)->stalled = true, at(address)->armed = false;
}
void dcd_edpt_clear_stall(uint8_t port, uint8_t address) { (void)port, at(address)->stalled = false; }

uint32_t tusb_time_millis_api(void) { return 0; }

static void complete(uint8_t address) {
  at(address)->armed = false;
  dcd_event_xfer_complete(0, address, at(address)->done, XFER_RESULT_SUCCESS, true);
  tud_task();
}

void host_plug_in(void) {
  static bool begun = false;
  tusb_rhport_init_t const init = {.role = TUSB_ROLE_DEVICE, .speed = TUSB_SPEED_AUTO};
  if (!begun) tusb_init(0, &init);
  begun = true;
  memset(endpoints, 0, sizeof endpoints);
  endpoints[0][0].packet = endpoints[0][1].packet = CFG_TUD_ENDPOINT0_SIZE;
  dcd_event_bus_reset(0, BULK_BYTES == 512 ? TUSB_SPEED_HIGH : TUSB_SPEED_FULL, true);
  tud_task();
}

void host_setup(uint8_t const *setup) {
  for (int way = 0; way < 2; way++) endpoints[0][way].stalled = endpoints[0][way].armed = false;
  dcd_event_setup_received(0, setup, true);
  tud_task();
}

int host_out(uint8_t address, uint8_t const *data, int length) {
  endpoint_t *e = at(address);
  if (e->stalled) return STALLED;
  if (!e->armed) return NAK;
  int const taken = TU_MIN(length, e->length - e->done);
  if (taken) memcpy(e->buffer + e->done, data, (size_t)taken);
  e->done = (uint16_t)(e->done + taken);
  if (e->done == e->length || length < e->packet) complete(address);
  return taken;
}

int host_in(uint8_t address, uint8_t *data) {
  endpoint_t *e = at(address);
  if (e->stalled) return STALLED;
  if (!e->armed) return NAK;
  int const given = TU_MIN(e->packet, e->length - e->done);
  if (given) memcpy(data, e->buffer + e->done, (size_t)given);
  e->done = (uint16_t)(e->done + given);
  if (e->done == e->length || given < e->packet) complete(address);
  return given;
}
