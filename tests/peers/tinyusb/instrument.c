/* The application above TinyUSB's USBTMC class: a message goes to `execute`, whose answer goes out as it is asked for. */
#include <string.h>
#include "tusb.h"

typedef int (*execute_t)(uint8_t const *message, int length, uint8_t *answer, int most);
typedef void (*trigger_t)(void);

static execute_t execute;
static trigger_t trigger;
static uint8_t message[1 << 20], answer[1 << 24];
static size_t message_length, answer_length, answer_sent;
static uint32_t requested;
static bool ends, request_waits;
static uint8_t status;
static bool mute;

void instrument_is(execute_t executes, trigger_t triggers) { execute = executes, trigger = triggers; }
void instrument_status(uint8_t value) { status = value; }
bool instrument_service_request(void) {
  uint8_t const packet[2] = {0x81, status};
  return tud_usbtmc_transmit_notification_data(packet, sizeof packet);
}

static bool respond(void) {
  size_t const size = TU_MIN((size_t)requested, answer_length - answer_sent);
  request_waits = false;
  answer_sent += size;
  return tud_usbtmc_transmit_dev_msg_data(answer + answer_sent - size, size, answer_sent == answer_length, false);
}

/* Nothing is answered while mute; what was asked for meanwhile is answered afterwards. */
void instrument_mute(bool on) {
  mute = on;
  if (!mute && request_waits && answer_length) respond();
}

static void forget(void) { message_length = answer_length = answer_sent = 0, request_waits = false; }

static usbtmc_response_capabilities_488_t const capabilities = {
    .USBTMC_status = USBTMC_STATUS_SUCCESS,
    .bcdUSBTMC = USBTMC_VERSION,
    .bcdUSB488 = USBTMC_488_VERSION,
    .bmIntfcCapabilities488 = {.supportsTrigger = 1, .is488_2 = 1},
    .bmDevCapabilities488 = {.SCPI = 1, .SR1 = 1, .DT1 = 1},
};
usbtmc_response_capabilities_488_t const *tud_usbtmc_get_capabilities_cb(void) { return &capabilities; }

void tud_usbtmc_open_cb(uint8_t interface) { (void)interface, forget(), tud_usbtmc_start_bus_read(); }

bool tud_usbtmc_msg_trigger_cb(usbtmc_msg_generic_t *header) { return (void)header, trigger(), true; }

bool tud_usbtmc_msgBulkOut_start_cb(usbtmc_msg_request_dev_dep_out const *header) {
  ends = header->bmTransferAttributes.EOM;
  return message_length + header->TransferSize <= sizeof message;
}
bool tud_usbtmc_msg_data_cb(void *data, size_t length, bool transfer_ends) {
  memcpy(message + message_length, data, length);
  message_length += length;
  if (transfer_ends && ends) {
    answer_length = (size_t)execute(message, (int)message_length, answer, sizeof answer);
    answer_sent = message_length = 0;
  }
  tud_usbtmc_start_bus_read();
  return true;
}
bool tud_usbtmc_msgBulkIn_request_cb(usbtmc_msg_request_dev_dep_in const *header) {
  requested = header->TransferSize;
  request_waits = mute || !answer_length;
  if (!request_waits) respond();
  return true;
}
bool tud_usbtmc_msgBulkIn_complete_cb(void) {
  if (answer_sent == answer_length) answer_sent = answer_length = 0;
  tud_usbtmc_start_bus_read();
  return true;
}

bool tud_usbtmc_initiate_clear_cb(uint8_t *result) { return forget(), *result = USBTMC_STATUS_SUCCESS, true; }
bool tud_usbtmc_check_clear_cb(usbtmc_get_clear_status_rsp_t *reply) {
  return reply->USBTMC_status = USBTMC_STATUS_SUCCESS, true;
}
bool tud_usbtmc_initiate_abort_bulk_in_cb(uint8_t *result) { return request_waits = false, *result = USBTMC_STATUS_SUCCESS, true; }
bool tud_usbtmc_check_abort_bulk_in_cb(usbtmc_check_abort_bulk_rsp_t *reply) { return (void)reply, tud_usbtmc_start_bus_read(), true; }
bool tud_usbtmc_initiate_abort_bulk_out_cb(uint8_t *result) { return message_length = 0, *result = USBTMC_STATUS_SUCCESS, true; }
bool tud_usbtmc_check_abort_bulk_out_cb(usbtmc_check_abort_bulk_rsp_t *reply) { return (void)reply, tud_usbtmc_start_bus_read(), true; }
void tud_usbtmc_bulkIn_clearFeature_cb(void) {}
void tud_usbtmc_bulkOut_clearFeature_cb(void) { tud_usbtmc_start_bus_read(); }

uint8_t tud_usbtmc_get_stb_cb(uint8_t *result) { return *result = USBTMC_STATUS_SUCCESS, status; }

static tusb_desc_device_t const device = {
    .bLength = 18, .bDescriptorType = TUSB_DESC_DEVICE, .bcdUSB = 0x0200, .bMaxPacketSize0 = CFG_TUD_ENDPOINT0_SIZE,
    .idVendor = 0x1209, .idProduct = 0x0001, .bcdDevice = 0x0100,
    .iManufacturer = 1, .iProduct = 2, .iSerialNumber = 3, .bNumConfigurations = 1,
};
enum { TOTAL = TUD_CONFIG_DESC_LEN + TUD_USBTMC_IF_DESCRIPTOR_LEN + TUD_USBTMC_BULK_DESCRIPTORS_LEN + TUD_USBTMC_INT_DESCRIPTOR_LEN };
static uint8_t const configuration[] = {
    TUD_CONFIG_DESCRIPTOR(1, 1, 0, TOTAL, 0, 100),
    TUD_USBTMC_IF_DESCRIPTOR(0, 3, 0, TUD_USBTMC_PROTOCOL_USB488),
    TUD_USBTMC_BULK_DESCRIPTORS(0x01, 0x82, BULK_BYTES),
    TUD_USBTMC_INT_DESCRIPTOR(0x83, 64, 1),
};
uint8_t const *tud_descriptor_device_cb(void) { return (uint8_t const *)&device; }
uint8_t const *tud_descriptor_configuration_cb(uint8_t index) { return (void)index, configuration; }
uint16_t const *tud_descriptor_string_cb(uint8_t index, uint16_t language) {
  static uint16_t text[32];
  static char const *const texts[] = {"", "NLOS", "TCSPC-488", "T1"};
  (void)language;
  if (index > 3) return NULL;
  size_t const length = index ? strlen(texts[index]) : 1;
  for (size_t k = 0; k < length; k++) text[1 + k] = index ? (uint16_t)texts[index][k] : 0x0409;
  text[0] = (uint16_t)(TUSB_DESC_STRING << 8 | (2 * length + 2));
  return text;
}
