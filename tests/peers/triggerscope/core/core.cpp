// Runs a sketch for a test, step by step: commands come on standard input, what the sketch did goes to standard output.
//   Rn\n + n bytes   these bytes arrive on the serial port together      Tn\n   the trigger input goes to level n
// and the answer, a line each, ends with a line of a single dot:
//   S hex   serial output     D hex   a frame to the DAC chip     P pin level     X pin level of the port expander
#include "SD.h"
#include "SPI.h"
#include "Wire.h"

void setup();
void loop();
void serialEvent();

SerialPort Serial;
SDClass SD;
SPIClass SPI;
TwoWire Wire;

static int levels[64];
static uint32_t now_ms;

static void hex(const char *kind, const std::string &data) {
    printf("%s ", kind);
    for (unsigned char c : data) printf("%02x", c);
    printf("\n");
}

int32_t integer(const char *text) {
    long long value = strtoll(text, nullptr, 10);
    return value > INT32_MAX ? INT32_MAX : value < INT32_MIN ? INT32_MIN : int32_t(value);
}

String String::substring(unsigned left, unsigned right) const {
    if (left > right) std::swap(left, right);
    if (left > held.size()) return String();
    return String(held.substr(left, right - left).c_str());  // cut at a NUL
}

int SerialPort::read() {
    if (received.empty()) return -1;
    unsigned char c = received[0];
    received.erase(0, 1);
    return c;
}

void pinMode(int, int) {}

void digitalWrite(int pin, int level) {
    if (pin == SS && !level) SPI.frame.clear();
    if (pin == SS && level && SPI.begun && !SPI.frame.empty()) hex("D", SPI.frame);
    if (levels[pin] != level && pin != SS) printf("P %d %d\n", pin, level);
    levels[pin] = level;
}

int digitalRead(int pin) { return levels[pin]; }
void delay(uint32_t milliseconds) { now_ms += milliseconds; }
uint32_t millis() { return now_ms; }

uint8_t SPIClass::transfer(uint8_t value) {
    frame.push_back(char(value));
    return 0;
}

void TwoWire::write(uint8_t value) {
    if (selecting) {
        selected = value;
        selecting = false;
        return;
    }
    int port = selected & 1;
    if (selected == 0x12 || selected == 0x13) {  // writing the port is writing its latch
        for (int bit = 0; bit < 8; bit++)
            if ((registers[selected] ^ value) >> bit & 1) printf("X %d %d\n", 8 * port + bit, value >> bit & 1);
        registers[0x14 + port] = value;
    }
    registers[selected] = value;
}

static void turn() {  // as the core's own main: the sketch's loop, then what waits on the serial port
    for (int i = 0; i < 3; i++) {
        loop();
        if (Serial.available()) serialEvent();
    }
    if (!Serial.sent.empty()) hex("S", Serial.sent);
    Serial.sent.clear();
    printf(".\n");
    fflush(stdout);
}

int main() {
    static char buffer[1 << 16];
    setup();
    turn();
    char kind;
    int number;
    while (scanf("%c%d", &kind, &number) == 2 && getchar() == '\n') {
        if (kind == 'T') levels[0] = number;
        if (kind == 'R') Serial.received.append(buffer, fread(buffer, 1, number, stdin));
        turn();
    }
}
